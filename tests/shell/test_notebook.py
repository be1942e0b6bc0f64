"""A notebook that a kernel runs without a screen: magics, pictures, and the manual's picture of it."""

import base64
import http.server
import importlib.util
import io
import json
import threading

import numpy as np
import pytest
from PIL import Image

from tools import draw_notebook
from tools.browser import Browser, chromium

# Not imported: a process with ipykernel is taken for a notebook.
MISSING = [name for name in ("nbconvert", "ipykernel") if importlib.util.find_spec(name) is None]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)}"),
]


@pytest.fixture(scope="module")
def outputs(tmp_path_factory):
    """What the cells of the notebook show: for each one a dictionary of types."""
    path = draw_notebook.executed(tmp_path_factory.mktemp("notebook"))
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    assert all(each["output_type"] != "error" for cell in cells for each in cell["outputs"])
    return [
        next((each["data"] for each in cell["outputs"] if "data" in each), {}) for cell in cells
    ]


def test_a_cell_of_selectscript_has_its_rows(ss, outputs):
    program = draw_notebook.CELLS[1].removeprefix("%%selectscript\n")
    shown = eval("".join(outputs[1]["text/plain"]), {"__builtins__": {}})  # noqa: S307
    assert shown == ss.eval(program)
    assert len(shown) > 1


def test_a_line_of_sql_has_a_table(ss, outputs):
    statement = draw_notebook.CELLS[2].removeprefix("rows = %sql ").removesuffix("\nrows")
    table = "".join(outputs[2]["text/html"])
    rows = ss.sql(statement).fetchall()
    assert len(rows) == 2
    for name, _ in rows:
        assert f"<td>{name}</td>" in table


def test_a_cloud_is_a_picture(outputs):
    content = base64.b64decode("".join(outputs[3]["image/png"]))
    picture = np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 8  # a colour for each entity


@pytest.mark.long
@pytest.mark.skipif(chromium() is None, reason="there is no Chromium")
def test_the_manuals_picture_of_a_notebook_is_up_to_date(tmp_path):
    drawn, stored = (
        np.asarray(Image.open(folder / "notebook.png").convert("RGB")).astype(int)
        for folder in (draw_notebook.draw(tmp_path).parent, draw_notebook.IMAGES)
    )
    assert stored.shape == drawn.shape
    # Fonts are not the same everywhere.
    assert (np.abs(stored - drawn).max(axis=2) > 48).mean() < 0.05


@pytest.mark.skipif(chromium() is None, reason="there is no Chromium")
def test_a_notebook_shows_a_world_in_place(ss, tmp_path):
    """The page of a notebook has another origin than the frame in it."""
    pytest.importorskip("websockets", reason="the extra view is not installed")

    class Notebook(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(view._repr_html_().encode())

        def log_message(self, *_):
            pass

    browser = Browser(tmp_path)
    try:
        with ss.view() as view, http.server.ThreadingHTTPServer(("127.0.0.1", 0), Notebook) as host:
            threading.Thread(target=host.serve_forever, daemon=True).start()
            page = browser.open(f"http://127.0.0.1:{host.server_port}/")
            page.wait("!!document.querySelector('iframe')")
            page.wait("document.readyState === 'complete'")
            assert not page.errors()
            wait_until_observed(ss, page)
            host.shutdown()
    finally:
        browser.close()


def wait_until_observed(ss, page):
    for _ in range(3000):
        if ss["kitchen"].observers.are_there:
            return
        page.value("new Promise(done => setTimeout(() => done(0), 20))")
    raise AssertionError("the frame of the page has no connection")
