"""Measures what each case and each fixture takes; `python -m tools.times` reports it.

The seconds of the last run are in pytest's cache, under the name `TIMES`: those of the calls, by case,
and those of the fixtures, by the folder or file and the name. A fixture's seconds are without those of
the fixtures that it names as parameters.
"""

from collections import defaultdict
from time import perf_counter

import pytest

TIMES = "ssduck/times"


class Times:
    """A plugin of pytest, for the processes that run tests and the one that hears of them."""

    def __init__(self, config):
        self._config = config
        self._set_up = []  # since the last report
        self._calls = {}
        self._fixtures = defaultdict(list)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef):
        begin = perf_counter()
        try:
            return (yield)
        finally:
            name = f"{fixturedef.baseid}::{fixturedef.argname}"
            self._set_up.append((name, perf_counter() - begin))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self):
        report = yield
        report.user_properties.append(("fixtures", self._set_up))
        self._set_up = []
        return report

    def pytest_runtest_logreport(self, report):
        if report.when == "call":
            self._calls[report.nodeid] = report.duration
        for name, value in report.user_properties:
            if name == "fixtures":
                for fixture, seconds in value:
                    self._fixtures[fixture].append(seconds)

    def pytest_sessionfinish(self):
        if self._calls and not hasattr(self._config, "workerinput"):
            self._config.cache.set(TIMES, {"calls": self._calls, "fixtures": self._fixtures})
