"""A browser for the tests of a module."""

import pytest


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    from tools.browser import Browser  # it needs an extra

    browser = Browser(tmp_path_factory.mktemp("browser"))
    yield browser
    browser.close()
