"""Draw docs/gallery and write docs/gallery.md: python scripts/make_gallery.py [NAME ...].

Each picture is drawn from runs that are flown for it; given names, only these are drawn.
"""

import shlex
import warnings
from collections.abc import Callable
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Annotated, NamedTuple

import gallery_pictures as pictures
import typer
from matplotlib.figure import Figure
from PIL import Image

import sato
from sato.figures.axes import styled
from sato.systems import load_system

DOCS = Path(__file__).parents[1] / "docs"
DPI = 110
COLORS = 128  # of a picture, which keep its file small


class Flight(NamedTuple):
    """Run that is flown for a picture."""

    scenario: str
    overrides: tuple[str, ...] = ()
    seed: int = 0

    @property
    def command(self) -> str:
        """Command that flies it."""
        words = ["sato", "run", self.scenario, *(["--seed", str(self.seed)] if self.seed else [])]
        return shlex.join([*words, *(word for each in self.overrides for word in ("--set", each))])

    @property
    def folder(self) -> str:
        """Folder that the command writes."""
        return f"runs/{self.scenario}-{self.seed}"


class Picture(NamedTuple):
    """Picture of one or more figures of a paper."""

    name: str  # of its file
    figures: str  # of the paper
    caption: str
    draw: str | Callable[..., Figure]  # a figure of `sato plot`, or a function of the runs
    flights: tuple[Flight, ...] = ()


class Paper(NamedTuple):
    """Figures and tables of a paper, in order; a text stands for what has no picture."""

    name: str
    title: str
    entries: tuple[Picture | str, ...]


def table(name: str, number: str, caption: str) -> str:
    """Return the text of a table, which a page of the documentation holds."""
    marks = f':start-after: "<!-- {name} begin -->"\n:end-before: "<!-- {name} end -->"'
    return (
        f"### Formation, Table {number}\n\n{caption}\n\n```{{include}} formation.md\n{marks}\n```\n"
    )


UIUC, ORBIT, LINKED = Flight("uiuc"), Flight("orbit"), Flight("connectivity")
SIX = Flight("formation6")
TEN = Flight(
    "random",
    ("swarm.agents=10", 'swarm.start={kind="random", box_m=16.0, separation_m=2.0}'),
    seed=1,
)
POINTS = "[[0.0, 0.0, 1.0], [3.4, 0.4, 1.0], [0.4, 2.6, 1.0], [3.8, 3.2, 1.0]]"
STARTS = "[[1.1, -0.6, 1.0], [0.7, 4.4, 1.0], [-3.2, 0.7, 1.0], [-0.6, 5.9, 1.0]]"
FOUR = Flight(
    "formation6",
    (
        "swarm.agents=4",
        f'swarm.start={{kind="points", positions_m={STARTS}}}',
        "assignment.first_s=0.0",
        "frames.offset_m=2.0",
        f'leg=[{{formation={{kind="points", positions_m={POINTS}, keep_order=true}}, '
        'graph={kind="pairs", pairs=[[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]]}}]',
    ),
    seed=2,
)
GRIDLOCK = Flight("formation6", ("avoidance.legacy_avoidance=true", "assignment.kind=none"), seed=1)

PAPERS = (
    Paper(
        "SATO",
        "SATO [Morgan2016]",
        (
            Picture(
                "sato-1", "Fig. 1",
                "Ten vehicles go to interchangeable targets (a). At the start (b) they form "
                "networks, by color and mark; dashed arrows are links.",
                pictures.draw_problem, (TEN,),
            ),
            Picture(
                "sato-2", "Fig. 2",
                "The prohibited circle (a) and its tangent half-plane (b), by the pair that comes "
                "closest in a flight; (c) the half-plane that clears all between two instants.",
                "half-space", (Flight("crossing"),),
            ),
            Picture(
                "sato-3", "Fig. 3",
                "Eq. (69) does not hold (a): both plan beyond hearing, within a horizon in which "
                "they can meet, and collide. Two that hold one target (b) hear each other before "
                "they meet, and one yields.",
                pictures.draw_conflicts, (Flight("undetectable"), Flight("conflict")),
            ),
            Picture(
                "sato-4", "Fig. 4",
                "123 vehicles after each reconfiguration, and after the loss of a quarter. Color "
                "and mark are of the network; a U with holes, and a C without.",
                "stages", (UIUC,),
            ),
            Picture(
                "sato-5", "Fig. 5",
                "From random positions to a U. Networks, by color and mark, merge on the way.",
                "first-leg", (UIUC,),
            ),
            Picture(
                "sato-6", "Fig. 6",
                "48 spacecraft in orbit form a circle in a quarter of a period. Lines are the last "
                "steps of each; a target is drawn where it will be at arrival.",
                "instants", (ORBIT,),
            ),
        ),
    ),
    Paper(
        "Formation",
        "Formation flight [Lusk2020]",
        (
            "### Formation, Fig. 1\n\nNot drawn: a photograph of six multirotors.\n",
            Picture(
                "formation-2", "Fig. 2",
                "All vehicles measure in one frame (a), in frames of equal orientation (b), or "
                "each in a frame of its own (c), as by default here.",
                pictures.draw_frames,
                (
                    Flight("formation6", ("frames.yaw=aligned", "frames.offset_m=0.0")),
                    Flight("formation6", ("frames.yaw=aligned",)),
                    SIX,
                ),
            ),
            Picture(
                "formation-3", "Fig. 3",
                "Parts of the method, and the files in which they are: a diagram, not a run.",
                pictures.draw_modules,
            ),
            Picture(
                "formation-4", "Fig. 4",
                "Vehicle 1 aligns a formation with itself and its neighbors 2 and 3, in its own "
                "frame, at the first auction of a flight. It knows nothing of vehicle 4, whose "
                "point is faded.",
                pictures.draw_alignment, (FOUR,),
            ),
            Picture(
                "formation-5", "Fig. 5",
                "100 vehicles form MIT ACL with 24 % of all edges: the last 50 s, 10 s of which "
                "they hover. Rings are where a vehicle was assigned another point.",
                pictures.draw_reassignments, (Flight("formation100"),),
            ),
            Picture(
                "formation-6", "Fig. 6",
                "The three formations of six, and their graphs, which are not complete.",
                pictures.draw_graphs, (SIX,),
            ),
            Picture(
                "formation-7", "Fig. 7",
                "Without assignment, and with the avoidance as printed, vehicles block each "
                "other's ways to their points, from above and from the side.",
                pictures.draw_gridlock, (GRIDLOCK,),
            ),
            table(
                "table1", "I",
                "[Design of gains](formation.md#table-i-time-to-design-gains-and-their-rate): "
                "`sato campaign run campaigns/table1.toml --workers 1`",
            ),
            table(
                "table2", "II",
                "[Simulated trials](formation.md#table-ii-30-vehicles-100-trials): "
                "`sato campaign run campaigns/table2-complete.toml`, and `table2-thinned.toml`",
            ),
            table(
                "table3", "III",
                "[Three formations, twice]"
                "(formation.md#table-iii-six-vehicles-three-formations-twice), simulated here, "
                "hardware in the paper:\n`sato campaign run campaigns/table3.toml`",
            ),
        ),
    ),
    Paper(
        "Connectivity",
        "Connectivity maintenance [Bernard2023]",
        (
            "### Connectivity, Fig. 1\n\nNot drawn: a screenshot of the authors' simulator.\n",
            Picture(
                "connectivity-2", "Fig. 2",
                "The potential of λ₂ (a), its negative slope (b), and the repulsion (c).",
                "potential", (LINKED,),
            ),
            Picture(
                "connectivity-3", "Fig. 3",
                "Rising and falling ramps, in the weights that are made of them: by distance both "
                "(a), by angle the falling one (b).",
                "weights", (LINKED,),
            ),
            Picture(
                "connectivity-4", "Figs. 4 and 5",
                "Trajectories in space (a) and from above (b), with a dot every 5 s. Stars are "
                "waypoints of the leader.",
                "paths", (LINKED,),
            ),
            Picture(
                "connectivity-6a", "Fig. 6, top",
                "λ₂ and its six estimates, and their errors; green while the stick is held.",
                "connectivity", (LINKED,),
            ),
            Picture(
                "connectivity-6b", "Fig. 6, bottom",
                "Number of edges, and of those where both see each other.",
                "edges", (LINKED,),
            ),
            Picture(
                "connectivity-7", "Fig. 7",
                "Errors of estimated relative yaws, on bands of the four kinds of visibility. "
                "Where neither of two sees the other, nothing corrects the estimate, or uses it.",
                "yaw", (LINKED,),
            ),
            "### Connectivity, Table I\n\nThe parameters are those of `sato show connectivity`.\n",
        ),
    ),
)  # fmt: skip
PICTURES = {
    each.name: each for paper in PAPERS for each in paper.entries if isinstance(each, Picture)
}


@cache
def fly(flight: Flight) -> sato.Run:
    """Fly a run once."""
    with warnings.catch_warnings(action="ignore"):  # of the avoidance as printed
        return sato.run(flight.scenario, seed=flight.seed, overrides=flight.overrides)


def draw(picture: Picture) -> Figure:
    """Draw a picture from its runs."""
    runs = [fly(flight) for flight in picture.flights]
    with styled():
        if isinstance(picture.draw, str):
            [run] = runs
            system = load_system(run.recorded.attrs["system"])
            return system.figures(run.recorded, run.drawn_mission)[picture.draw]()
        return picture.draw(*runs)


def to_png(figure: Figure) -> bytes:
    """Return a figure as a PNG of few colors."""
    with styled(), BytesIO() as large, BytesIO() as small:
        figure.savefig(large, format="png", dpi=DPI)
        image = Image.open(large).convert("RGB")
        # By median cut, rare colors would be lost.
        few = image.quantize(COLORS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        few.save(small, format="png", optimize=True)
        return small.getvalue()


def format_page() -> str:
    """Return docs/gallery.md."""
    parts = [
        "# Gallery\n\nFigures and tables of the three papers, in their order. Each picture is "
        "drawn from runs of this repository,\nby the commands below it. `make gallery` draws all, "
        "`make gallery FIGURE=sato-3` one. How far each agrees\nwith the paper is in the "
        "[map of the papers](papers.md).\n"
    ]
    for paper in PAPERS:
        parts.append(f"## {paper.title}\n")
        for each in paper.entries:
            parts.append(each if isinstance(each, str) else _format_picture(paper.name, each))
    return "\n".join(parts)


def _format_picture(paper: str, picture: Picture) -> str:
    lines = [flight.command for flight in picture.flights]
    if isinstance(picture.draw, str):
        lines.append(f"sato plot {picture.flights[0].folder}   # {picture.draw}.png")
    else:
        lines.append(f"make gallery FIGURE={picture.name}")
    code = "\n".join(["```", *lines, "```"])
    title = f"{paper}, {picture.figures}"
    image = f"![{title}](gallery/{picture.name}.png)"
    return f"### {title}\n\n{image}\n\n{picture.caption}\n\n{code}\n"


def main(
    names: Annotated[list[str] | None, typer.Argument(help=f"of {', '.join(PICTURES)}")] = None,
) -> None:
    """Draw pictures, all by default, and write the page."""
    chosen = names or list(PICTURES)
    if unknown := [name for name in chosen if name not in PICTURES]:
        raise typer.BadParameter(f"there is no {unknown[0]}; names are {', '.join(PICTURES)}")
    (DOCS / "gallery").mkdir(exist_ok=True)
    for name in chosen:
        content = to_png(draw(PICTURES[name]))
        path = DOCS / "gallery" / f"{name}.png"
        path.write_bytes(content)
        typer.echo(f"{path}, {len(content) / 1000:.0f} kB")
    (DOCS / "gallery.md").write_text(format_page(), encoding="utf-8")


if __name__ == "__main__":
    typer.run(main)
