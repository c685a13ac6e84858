"""Notice of compilation: once, when kernels are compiled, and not when they are cached."""

import os
import subprocess
import sys

import numba

from sato import compilation
from sato.compilation import NOTICE, announce_compilation

COLD = """
import sato
with __import__("sato.compilation", fromlist=["x"]).announce_compilation():
    from sato.auctions.vsdaa import VsdaaAuction, run_vsdaa
    from sato.network.graph import CommunicationGraph
    import numpy as np
    graph = CommunicationGraph(~np.eye(2, dtype=bool), np.ones(2, dtype=bool))
    print(graph.diameter)
"""


def test_notice_is_printed_once_when_a_kernel_is_compiled(capsys, monkeypatch):
    monkeypatch.setattr(compilation, "_notice", compilation._Notice())
    first, second = (numba.njit(lambda x, y=y: x + y) for y in (1, 2))
    with announce_compilation():
        assert capsys.readouterr().err == ""
        assert (first(1), second(1)) == (2, 3)
    with announce_compilation():
        assert numba.njit(lambda x: x)(1) == 1
    assert capsys.readouterr().err == f"{NOTICE}\n"


def test_notice_is_not_printed_where_it_is_not_asked_for(capsys, monkeypatch):
    monkeypatch.setattr(compilation, "_notice", compilation._Notice())
    with announce_compilation(False):
        assert numba.njit(lambda x: x + 3)(1) == 4
    assert capsys.readouterr().err == ""


def test_cached_kernels_print_no_notice(tmp_path):
    said = []
    for _ in range(2):
        env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
        done = subprocess.run(
            [sys.executable, "-c", COLD], env=env, capture_output=True, text=True, check=True
        )
        said.append(done.stderr)
    assert said == [f"{NOTICE}\n", ""]
