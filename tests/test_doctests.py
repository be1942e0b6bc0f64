"""Runs the examples in the docstrings of every module of ssduck and of its example programs."""

import doctest
import pkgutil
from importlib import import_module

import pytest

import examples.cleanup
import ssduck
from ssduck.adapters import registry

MODULES = sorted(
    module.name
    for package in (ssduck, examples.cleanup)
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    if not module.name.endswith("__main__")
)
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


@pytest.mark.slow
@pytest.mark.parametrize("name", MODULES)
def test_examples_of_docstrings_give_what_they_say(name, monkeypatch):
    monkeypatch.setattr(registry, "_ADAPTERS", dict(registry._ADAPTERS))
    result = doctest.testmod(import_module(name), optionflags=OPTIONS)
    assert result.failed == 0
