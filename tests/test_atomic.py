"""Files under final names: the earlier one or a whole new one, however a process ends."""

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
