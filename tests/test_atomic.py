"""Files under final names: the earlier one or a whole new one, however a process ends."""

import fcntl
import os
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from sato.atomic import (
    PREFIX,
    is_held,
    remove_leftovers,
    replace_atomically,
    replace_together,
)

WRITE_AND_DIE = """
import os, sys
from pathlib import Path
from sato.atomic import replace_atomically
with replace_atomically(Path(sys.argv[1])) as new:
    new.write_text("half")
    os.kill(os.getpid(), 9)
"""


@pytest.mark.parametrize("is_there", [True, False])
def test_a_process_killed_while_it_writes_leaves_what_was_there(tmp_path, is_there):
    path = tmp_path / "table.nc"
    if is_there:
        path.write_text("earlier")
    done = subprocess.run([sys.executable, "-c", WRITE_AND_DIE, path])
    assert done.returncode == -9
    assert [p.read_text() for p in tmp_path.glob("table.nc")] == ["earlier"] * is_there


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_an_interrupted_writer_leaves_nothing_but_what_was_there(tmp_path, error):
    (tmp_path / "oem").mkdir()
    (tmp_path / "oem" / "a.oem").write_text("earlier")
    with pytest.raises((KeyboardInterrupt, OSError)), replace_atomically(tmp_path / "oem") as new:
        new.mkdir()
        (new / "a.oem").write_text("half")
        raise error
    assert [p.name for p in tmp_path.iterdir()] == ["oem"]
    assert (tmp_path / "oem" / "a.oem").read_text() == "earlier"


@pytest.mark.parametrize("leads", ["run.nc", "gone", "folder"])
def test_a_link_is_replaced_and_what_it_leads_to_stays(tmp_path, leads):
    (tmp_path / "run.nc").write_text("earlier")
    (tmp_path / "folder").mkdir()
    for is_folder in (False, True):
        link = tmp_path / f"link {is_folder}"
        link.symlink_to(leads)
        with replace_atomically(link) as new:
            new.mkdir() if is_folder else new.write_text("whole")
        assert not link.is_symlink() and link.is_dir() == is_folder
    assert (tmp_path / "run.nc").read_text() == "earlier"
    assert sorted(path.name for path in (tmp_path / "folder").iterdir()) == []
    assert not list(tmp_path.glob(".saving-*")) and not (tmp_path / "gone").exists()


def test_what_is_no_file_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")  # as /dev/stdout
    for name in ("pipe", "link"):
        with pytest.raises(OSError, match="neither a file nor a folder"):
            replace_atomically(tmp_path / name).__enter__()
        assert (tmp_path / name).is_fifo()


def test_a_folder_that_another_program_has_locked_is_written_to(tmp_path):
    lock = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    with replace_atomically(tmp_path / "a") as new:
        new.write_text("whole")
    os.close(lock)
    assert contents(tmp_path) == {"a": "whole"}


def test_files_are_written_where_there_are_no_locks(tmp_path, monkeypatch):
    def refuse(*_):  # as network file systems do
        raise OSError(9, "Bad file descriptor")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with replace_atomically(tmp_path / "a") as new:
        remove_leftovers(tmp_path)
        new.write_text("whole")
    assert contents(tmp_path) == {"a": "whole"}


def test_a_folder_taken_for_a_leftover_is_made_again(tmp_path, monkeypatch):
    flock, taken = fcntl.flock, []

    def take(lock, option):
        if not taken:
            taken.extend(path.rmdir() or path for path in tmp_path.glob(f"{PREFIX}*"))
        flock(lock, option)

    monkeypatch.setattr(fcntl, "flock", take)
    with replace_atomically(tmp_path / "a") as new:
        new.write_text("whole")
    assert taken and contents(tmp_path) == {"a": "whole"}


@pytest.mark.parametrize("name", ["old", "oem"])
def test_a_folder_of_any_name_is_replaced_or_kept(tmp_path, name, monkeypatch):
    (tmp_path / name).mkdir()
    with replace_atomically(tmp_path / name) as new:
        new.mkdir()
        (new / "a").write_text("whole")
    assert (tmp_path / name / "a").read_text() == "whole"

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt), replace_atomically(tmp_path / name) as new:
        new.mkdir()
    assert [p.name for p in (tmp_path / name).iterdir()] == ["a"]


def contents(folder):
    return {path.name: path.read_text() for path in folder.iterdir()}


def write_all(folder, fails=lambda: None):
    with replace_together(folder, [folder / "old"]) as new:
        for name in ("a", "b", "c"):
            (new / name).write_text("new")
        fails()


def test_files_are_replaced_together_and_old_ones_go(tmp_path):
    for name in ("a", "b", "old", "mine"):
        (tmp_path / name).write_text("former")
    write_all(tmp_path)
    assert contents(tmp_path) == dict.fromkeys("abc", "new") | {"mine": "former"}


@pytest.mark.parametrize("count", range(8))
def test_files_stay_together_wherever_their_replacement_stops(tmp_path, count, monkeypatch):
    former = dict.fromkeys(("a", "b", "old"), "former")
    for name, text in former.items():
        (tmp_path / name).write_text(text)
    moves, rename = iter(range(count)), os.rename

    def stop(*paths):
        if next(moves, None) is None:
            monkeypatch.setattr(os, "rename", rename)
            raise KeyboardInterrupt
        rename(*paths)

    monkeypatch.setattr(os, "rename", stop)
    with pytest.raises(KeyboardInterrupt) if count < 7 else nullcontext():
        write_all(tmp_path)
    # Three are moved away, their folder is renamed, and three are moved into place.
    assert contents(tmp_path) == (former if count < 4 else dict.fromkeys("abc", "new"))


KILLED = """
import os, sys
from pathlib import Path
from sato.atomic import replace_atomically, replace_together
folder, count = Path(sys.argv[1]), int(sys.argv[2])
def die(move):
    def count_down(*paths):
        global count
        if count == 0:
            os.kill(os.getpid(), 9)
        count -= 1
        move(*paths)
    return count_down
os.rename, os.replace = die(os.rename), die(os.replace)
"""
WRITE_TOGETHER = """
with replace_together(folder, [folder / "old"]) as new:
    for name in ("a", "b"):
        (new / name).write_text("new")
"""
WRITE_FOLDER = """
with replace_atomically(folder / "oem", [folder / "old"]) as new:
    new.mkdir()
    (new / "a").write_text("new")
"""


@pytest.mark.parametrize("count", range(7))
def test_next_command_finishes_or_undoes_what_a_killed_one_has_moved(tmp_path, count):
    for name in ("a", "b", "old"):
        (tmp_path / name).write_text("former")
    subprocess.run([sys.executable, "-c", KILLED + WRITE_TOGETHER, tmp_path, str(count)])
    left = {path.read_text() for path in tmp_path.iterdir() if path.is_file()}
    assert len(left) < 2
    remove_leftovers(tmp_path)
    is_new = count > 3  # three are moved away, and their folder is renamed
    names = "ab" if is_new else ("a", "b", "old")
    assert contents(tmp_path) == dict.fromkeys(names, "new" if is_new else "former")


@pytest.mark.parametrize("count", range(4))
def test_folder_of_which_a_replacement_was_killed_comes_back(tmp_path, count):
    (tmp_path / "oem").mkdir()
    for path in (tmp_path / "oem" / "a", tmp_path / "old"):
        path.write_text("former")
    subprocess.run([sys.executable, "-c", KILLED + WRITE_FOLDER, tmp_path, str(count)])
    remove_leftovers(tmp_path)
    is_new = count == 3
    assert (tmp_path / "oem" / "a").read_text() == ("new" if is_new else "former")
    assert {path.name for path in tmp_path.iterdir()} == ({"oem"} if is_new else {"oem", "old"})


@pytest.mark.parametrize("is_own", [True, False])
def test_what_was_moved_comes_back_from_an_own_leftover_alone(tmp_path, is_own, monkeypatch):
    place = tmp_path / f"{PREFIX}dead"
    for name in ("new", "former"):
        (place / name).mkdir(parents=True)
        (place / name / "a").write_text(name)
    if not is_own:  # somebody else's, in a folder for all

        def stat(path, **options):
            found = os.stat(path, **options)
            return SimpleNamespace(st_uid=found.st_uid + (path == place), st_mode=found.st_mode)

        monkeypatch.setattr(Path, "stat", stat)
    remove_leftovers(tmp_path)
    monkeypatch.undo()
    assert contents(tmp_path) == ({"a": "former"} if is_own else {})


def test_what_another_writer_has_written_meanwhile_stays(tmp_path):
    place = tmp_path / f"{PREFIX}dead"
    for name in ("new", "former"):
        (place / name).mkdir(parents=True)
        (place / name / "a").write_text(name)
    (tmp_path / "a").write_text("latest")
    remove_leftovers(tmp_path)
    assert contents(tmp_path) == {"a": "latest"}


def test_lock_is_held_as_long_as_its_process_lives(tmp_path):
    text = (
        "import sys; from pathlib import Path; from sato.atomic import open_scratch\n"
        "with open_scratch(Path(sys.argv[1])) as place: print(place, flush=True); input()"
    )
    words, pipe = [sys.executable, "-c", text, tmp_path], subprocess.PIPE
    with subprocess.Popen(words, stdin=pipe, stdout=pipe, text=True) as process:
        place = Path(process.stdout.readline().strip())
        remove_leftovers(tmp_path)
        assert is_held(place)
        process.kill()
        while process.poll() is None:
            pass
    assert place.exists() and not is_held(place) and not is_held(tmp_path / "gone")
    remove_leftovers(tmp_path)
    assert not place.exists()


def test_a_folder_of_the_name_of_a_new_file_is_not_replaced(tmp_path):
    (tmp_path / "b").mkdir()
    (tmp_path / "a").write_text("former")
    with pytest.raises(OSError, match="b is a folder, and stays as it is"):
        write_all(tmp_path)
    assert (tmp_path / "b").is_dir() and (tmp_path / "a").read_text() == "former"
    assert len(list(tmp_path.iterdir())) == 2


def test_an_error_leaves_all_files_and_names_their_folder(tmp_path):
    (tmp_path / "a").write_text("former")

    def fail():
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space") as caught:
        write_all(tmp_path, fail)
    assert caught.value.filename == str(tmp_path) and contents(tmp_path) == {"a": "former"}
