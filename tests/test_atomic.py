"""Files under final names: the earlier one or a whole new one, however a process ends."""

import fcntl
import os
import subprocess
import sys

import pytest

from sato.atomic import PREFIX, remove_leftovers, replace_atomically, replace_together

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
    path = tmp_path / "run.nc"
    if is_there:
        path.write_text("earlier")
    done = subprocess.run([sys.executable, "-c", WRITE_AND_DIE, path])
    assert done.returncode == -9
    assert [p.read_text() for p in tmp_path.glob("run.nc")] == ["earlier"] * is_there


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


@pytest.mark.parametrize("count", range(7))
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
    if count == 6:  # three are moved away, and three into place
        write_all(tmp_path)
        assert contents(tmp_path) == dict.fromkeys("abc", "new")
    else:
        with pytest.raises(KeyboardInterrupt):
            write_all(tmp_path)
        assert contents(tmp_path) == former


KILLED = """
import os, sys
from pathlib import Path
from sato.atomic import replace_together
count, rename = int(sys.argv[2]), os.rename
def die(*paths):
    global count
    if count == 0:
        os.kill(os.getpid(), 9)
    count -= 1
    rename(*paths)
os.rename = die
folder = Path(sys.argv[1])
with replace_together(folder) as new:
    for name in ("a", "b"):
        (new / name).write_text("new")
"""


@pytest.mark.parametrize("count", range(4))
def test_a_process_killed_amid_a_replacement_leaves_no_mixture(tmp_path, count):
    for name in ("a", "b"):
        (tmp_path / name).write_text("former")
    subprocess.run([sys.executable, "-c", KILLED, tmp_path, str(count)])
    left = {path.read_text() for path in tmp_path.iterdir() if path.is_file()}
    assert len(left) < 2


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
