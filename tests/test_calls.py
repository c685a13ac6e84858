"""Public functions: each has a valid call, and refuses wrong ones in words of the library."""

import os
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
import fuzz_calls


@pytest.fixture(scope="module")
def examples(tmp_path_factory):
    before = Path.cwd()
    os.chdir(tmp_path_factory.mktemp("calls"))  # where examples write their files
    yield fuzz_calls.load_examples()
    os.chdir(before)


def test_every_public_function_and_class_has_a_valid_call(examples):
    assert fuzz_calls.public_names() <= set(examples)


def test_wrong_calls_are_refused_in_words_of_the_library(examples):
    faults = list(fuzz_calls.fuzz(300, 5))
    assert not faults, [(example.name, *rest) for example, *rest in faults]
