"""Films of all systems: they show vehicles where they were, with all links."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest

import sato
from sato.figures.style import STYLE
from sato.film import SwarmFilm
from sato.scene import list_links

FLIGHTS = {
    "formation6": ["leg=[{formation={kind='library', name='swarm6_3d/Slanted Plane'}}]"],
    "connectivity": ["run.duration_s=2.0", "start_s=0", "obstacles.count=3"],
    "random3d": ["swarm.agents=8"],
}


@pytest.mark.parametrize("name", FLIGHTS)
def test_film_shows_vehicles_and_links_as_flown(name):
    scene = sato.run(name, overrides=FLIGHTS[name]).scene()
    with matplotlib.rc_context(STYLE):
        film = SwarmFilm(scene)
        k = len(scene.time) // 2
        film.draw_frame(float(scene.time[k]))
        film.canvas.draw()
    shown = [line for line in film.axes.lines if line.get_zorder() == 3]
    at = np.concatenate([np.stack(line.get_data_3d(), axis=-1) for line in shown])
    there = scene.position[k, scene.status[k] == 1]
    assert sorted(map(tuple, at.round(9))) == sorted(map(tuple, there.round(9)))
    [links] = [each for each in film.axes.collections if each.get_label() == scene.links.name]
    assert len(links.get_segments()) == len(list_links(scene, k)) > 0
    assert film.axes.get_title().startswith(scene.stages[0][1][:3])


def test_film_of_a_scene_without_categories_shows_all_vehicles_alike():
    scene = sato.run("crossing").scene()
    bare = replace(scene, colorings=tuple(c for c in scene.colorings if not c.categories))
    with matplotlib.rc_context(STYLE):
        film = SwarmFilm(bare)
    shown = [line for line in film.axes.lines if line.get_zorder() == 3]
    assert sum(len(line.get_xdata()) for line in shown) == 2
