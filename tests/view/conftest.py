"""A browser, and a record, for the tests of a module."""

import pytest

import ssduck


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    from tools.browser import Browser  # it needs an extra

    browser = Browser(tmp_path_factory.mktemp("browser"))
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def record(tmp_path_factory, archive):
    """A cup that is lifted from the table, and put back."""
    return archive.copy(write_lifted_cup, tmp_path_factory.mktemp("record") / "run")


def write_lifted_cup(path):
    with ssduck.load("kitchen") as ss:
        cup = ss["kitchen"]["cup_905a"]
        ss.run(0.1)
        x, y, z = map(float, cup.position)
        with ss.record_to(path):
            for step in range(60):
                ss["kitchen"].step()
                if 20 <= step < 25:
                    cup.move([x, y, z + 0.5])
                elif step == 25:
                    cup.move([x, y, z])


@pytest.fixture(scope="module")
def served(record):
    from ssduck.view.view import view_record  # it needs an extra

    with view_record(record) as served:
        yield served
