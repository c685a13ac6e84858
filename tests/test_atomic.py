"""Files under final names: the earlier one or a whole new one, however a process ends."""

import os
import subprocess
import sys

import pytest

from sato.atomic import replace_atomically

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


def test_a_link_stays_and_what_it_leads_to_is_replaced(tmp_path):
    (tmp_path / "run.nc").write_text("earlier")
    (tmp_path / "link").symlink_to("run.nc")
    with replace_atomically(tmp_path / "link") as new:
        new.write_text("whole")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "run.nc").read_text() == "whole"


def test_what_is_no_file_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="neither a file nor a folder"):
        replace_atomically(tmp_path / "pipe").__enter__()
    assert (tmp_path / "pipe").is_fifo()


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
