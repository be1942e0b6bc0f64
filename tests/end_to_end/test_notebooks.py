"""What notebooks show: pictures of worlds, and errors without the frames of ssduck."""

import io
import subprocess
import sys
import textwrap
import types

import numpy as np
import pybullet
import pytest
from PIL import Image

import ssduck
from ssduck.errors import SelectScriptError
from tests.support.timing import HANGS
from tests.support.warned import silent


@pytest.fixture(scope="module")
def hall():
    with ssduck.load("hall") as ss:
        yield ss


def pixels(png):
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def shown(code, names):
    """The lines that a notebook shows of the error of a cell."""
    names["__name__"] = "__main__"
    with pytest.raises(SelectScriptError) as caught:
        exec(compile(textwrap.dedent(code), "cell.py", "exec"), names)  # noqa: S102
    machinery = types.FunctionType(compile("raise error", "shell.py", "exec"), {})
    machinery.__globals__.update({"__name__": "IPython.core", "error": caught.value})
    try:
        machinery()
    except SelectScriptError as error:
        return "\n".join(error._render_traceback_()).splitlines()


def test_an_error_is_its_message_and_its_place(hall):
    lines = shown("x = 1\nss.eval('SELECT idd FROM hall;')", {"ss": hall})
    assert lines[-4:] == [
        "UnknownNameError: there is no function 'idd', and no variable; the worlds are hall; did you "
        "mean 'id' or 'add'?",
        "  line 1, column 8",
        "    SELECT idd FROM hall;",
        "           ^^^",
    ]
    assert '  File "cell.py", line 2, in <module>' in lines
    assert not any("ssduck" in line or "shell.py" in line for line in lines)
    assert len(lines) < 12


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "told"),
    [
        ("ss.sql('SELECT idd FROM entities')", "SqlError: Binder Error"),
        ("ss.show('1 +;')", "ParseError: "),
        ("ss.call_variable('hall')['gaol']", "did you mean 'goal'"),
        ("ss.call_variable('hall').step(0.5)", "NumberError: "),
        ("import ssduck; ssduck.load('hal')", "did you mean 'hall'"),
    ],
)
def test_other_errors(hall, code, told):
    lines = shown(code, {"ss": hall})
    assert any(told in line for line in lines)
    assert len(lines) < 12
    assert not any("/ssduck/" in line for line in lines)


def test_an_error_of_a_function_shows_its_line(hall):
    code = """
    def heavy(entity):
        return 1 / 0

    ss.add_function("heavy", heavy, "Is it heavy?")
    ss.eval("SELECT id FROM hall WHERE heavy(this);")
    """
    lines = shown(code, {"ss": hall})
    places = [line.strip() for line in lines if 'File "cell.py"' in line]
    assert places[-2:] == [
        'File "cell.py", line 6, in <module>',
        'File "cell.py", line 3, in heavy',
    ]
    assert any(line.startswith("FunctionError: heavy: ZeroDivisionError") for line in lines)
    assert not any("/ssduck/" in line for line in lines)


@pytest.mark.slow
def test_a_world_is_a_picture(hall, tmp_path):
    world = hall.call_variable("hall")
    now = pixels(world._repr_png_())
    assert now.shape == (480, 640, 3)
    assert (now == world.render(640, 480)).all()
    lifted = world.what_if({world["rover"]: [1, 0, 0, 0, 6, 4, 3]})
    assert (pixels(lifted._repr_png_()) != now).any(axis=2).mean() > 0.001
    world.step()
    world["rover"].move([6, 4, 3])
    moments = hall.eval("hall{0.0};")
    past = moments.record.at(moments.first)
    assert (pixels(past._repr_png_()) != now).any(axis=2).mean() < 0.001
    hall.export(tmp_path / "run")
    with ssduck.open(tmp_path / "run") as record, silent():
        assert len(np.unique(pixels(record.call_variable("hall")._repr_png_()))) > 10


def test_an_attached_world_is_a_picture_as_long_as_its_client_lives(client):
    world = ssduck.World.attach(client)
    assert world._repr_png_().startswith(b"\x89PNG")
    pybullet.disconnect(client)
    assert world._repr_png_() is None


KERNEL = """
import sys, types
shell = types.SimpleNamespace(config={"IPKernelApp": {}})
sys.modules["IPython"] = types.ModuleType("IPython")
sys.modules["IPython"].get_ipython = lambda: shell
sys.modules["ipywidgets"] = None
import duckdb
try:
    duckdb.connect().execute("SET enable_progress_bar = false")
except duckdb.InvalidInputException as error:
    assert "ipywidgets" in str(error), error
    import ssduck
    print(ssduck.Interpreter().sql("SELECT 1 AS one").fetchall())
"""


@pytest.mark.slow
def test_a_kernel_needs_no_widgets():
    """DuckDB takes the process for a kernel, and refuses settings of its progress bar."""
    done = subprocess.run(
        [sys.executable, "-c", KERNEL], capture_output=True, text=True, timeout=HANGS, check=False
    )
    assert (done.returncode, done.stdout) == (0, "[(1,)]\n"), done.stderr


def test_printed_tables_fit_the_page(hall, monkeypatch):
    class Page(io.TextIOBase):
        """Like the standard output of a kernel: no terminal, and no buffer below."""

        text = ""

        def write(self, text):
            self.text += text
            return len(text)

    result = hall.sql("SELECT * FROM entities")
    monkeypatch.setitem(sys.modules, "ipykernel", types.ModuleType("ipykernel"))
    monkeypatch.setattr(sys, "stdout", Page())
    result.show(rows=4)
    lines = sys.stdout.text.splitlines()
    assert max(map(len, lines)) <= 100
    assert "…" in lines[0]
