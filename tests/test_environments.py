"""Machines where nobody planned: what hides packages, folders that cannot be written, settings."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace

import matplotlib
import numba
import numpy as np
import pytest

import sato
from problems import kernels
from problems.solvers import load_adapters
from sato.figures.axes import styled
from sato.workers import check_guard


def python(*words, cwd, **changes):
    env = os.environ | {"PYTHONPATH": os.path.dirname(os.path.dirname(sato.__file__))} | changes
    return subprocess.run(
        [sys.executable, *words], cwd=cwd, env=env, capture_output=True, text=True, timeout=300
    )


@pytest.mark.parametrize("name", ["dynamics", "problems"])
def test_file_that_hides_a_package_is_named(tmp_path, name):
    (tmp_path / f"{name}.py").write_text("x = 1\n")
    (tmp_path / "fly.py").write_text("import sato\nsato.run('crossing')\n")
    for words in (["fly.py"], ["-m", "sato", "scenarios"]):
        done = python(*words, cwd=tmp_path)
        assert done.returncode != 0
        last = done.stderr.strip().splitlines()[-1]
        assert f"{tmp_path / name}.py hides " in last and "another name" in last
    assert done.stderr.count("\n") == 1  # of the command line


def test_functions_of_a_campaign_are_in_no_package_of_the_library(tmp_path):
    (tmp_path / "c.toml").write_text('[campaign]\nfunction = "dynamics:f"\ntrials = 1\n')
    done = python("-m", "sato", "campaign", "run", "c.toml", "--out", "o", cwd=tmp_path)
    assert done.returncode == 2
    assert '"dynamics:f": dynamics is a package of this library; another name' in done.stderr


def test_script_without_a_guard_is_told_so_in_one_sentence(tmp_path):
    (tmp_path / "fly.py").write_text(
        "import sato\n"
        "try:\n    sato.campaign('crossing', trials=2, out='o')\n"
        "except sato.InputError as error:\n    print(error)\n"
    )
    done = python("fly.py", cwd=tmp_path)
    assert done.stderr == "" and done.stdout.count("\n") == 1
    assert 'a line `if __name__ == "__main__":` above what starts them would do' in done.stdout
    check_guard()  # that of the tests has one


def test_commands_write_ascii_where_the_output_takes_nothing_else(tmp_path):
    for words in (["run", "crossing", "--out", "r"], ["check", "r"], ["campaign", "--help"]):
        done = python("-m", "sato", *words, cwd=tmp_path, PYTHONIOENCODING="ascii", PYTHONUTF8="0")
        assert done.returncode == 0 and done.stdout.isascii() and "Error" not in done.stderr


def test_flights_without_compiled_kernels_are_the_same(tmp_path):
    done = python(
        "-m", "sato", "run", "crossing", "--out", "r", cwd=tmp_path, NUMBA_DISABLE_JIT="1"
    )
    assert done.returncode == 0, done.stderr
    plain = sato.load(tmp_path / "r")
    assert np.array_equal(plain.data.position, sato.run("crossing").data.position)


def test_kernels_are_kept_elsewhere_where_nothing_can_be_written(tmp_path, monkeypatch):
    folders, njit = [], numba.njit

    def refuse(**options):
        def decorate(function):
            folders.append(numba.config.CACHE_DIR)
            if not numba.config.CACHE_DIR:
                raise RuntimeError("cannot cache function: no locator available")
            return njit(**options)(function)

        return decorate

    monkeypatch.setattr(kernels.numba, "njit", refuse)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(kernels.tempfile, "gettempdir", lambda: str(tmp_path))
    assert kernels.compiled()(lambda x: x + 1)(1) == 2
    (made,) = tmp_path.iterdir()
    assert folders == ["", str(made)] and made.stat().st_mode & 0o777 == 0o700
    made.chmod(0o777)  # of anybody, who might put code there
    assert kernels._find_cache() != str(made)
    shutil.rmtree(made)
    made.write_text("of somebody who would keep it from being made")
    assert kernels._find_cache() != str(made)


def test_figures_have_our_settings_alone():
    with matplotlib.rc_context({"text.usetex": True, "font.size": 30, "lines.linewidth": 9}):
        with styled():
            assert not matplotlib.rcParams["text.usetex"]
            assert matplotlib.rcParams["font.size"] == 8.5
            assert matplotlib.rcParams["lines.linewidth"] == 1.5
        assert matplotlib.rcParams["font.size"] == 30


def test_solvers_print_nothing(capfd):
    overrides = ["plan.horizon_steps=7", "model.speed_norm=inf", "plan.objective=energy"]
    solver = "casadi-qpoases"
    if solver not in load_adapters():
        pytest.skip("CasADi has no qpOASES")
    sato.run("crossing", overrides=[*overrides, f"plan.solver={solver}"])
    assert capfd.readouterr().out == ""


def test_exception_in_a_flight_leaves_its_record(monkeypatch):
    from sato.reconfiguration import loop

    fly, instants = loop.simulate, 4

    def fail(*given):
        for k, frame in enumerate(fly(*given)):
            if k == instants:
                raise IndexError("index 7 is out of bounds")
            yield frame

    fail.__module__ = "sato.reconfiguration.loop"  # not of a user's own, which are told otherwise
    system = sato.systems.load_system("reconfiguration")
    monkeypatch.setattr("sato.runs.load_system", lambda _: replace(system, simulate=fail))
    run = sato.run("crossing")
    assert len(run.data.time) == instants and run.verdict == "not reached"
    assert "a fault of the program: IndexError: index 7" in run.summary["stopped"]
    with pytest.raises(IndexError):
        sato.run("crossing", strict=True)


def test_a_command_whose_reader_has_gone_ends_as_shells_have_it(tmp_path):
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "sato", "keys", "connectivity"]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, cwd=tmp_path)
    os.close(write)
    assert (done.returncode, done.stderr) == (141, b"")
