"""How tests run the command `ssduck`."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ssduck.cli.app import app
from tests.support.timing import HANGS

ROOT = Path(__file__).resolve().parents[2]

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="signals and devices of Linux")

BOX = """\
<robot name="box"><link name="base">
  <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="1 1 1"/></geometry></collision>
</link></robot>
"""

SCENE = """\
name = "two"
timestep = 0.01
[[body]]
name = "big"
urdf = "box.urdf"
fixed = true
[[body]]
name = "small"
urdf = "box.urdf"
position = [0.25, -0.0, 2.0]
"""


def write_scene(folder):
    """A scene of two boxes; quick to load."""
    (folder / "box.urdf").write_text(BOX)
    (folder / "two.toml").write_text(SCENE)
    return folder


def ssduck_(*arguments, input=None, env=None):
    """Run the command in this process."""
    result = CliRunner().invoke(app, arguments, input=input, env=env, prog_name="ssduck")
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def answer(*arguments, **others):
    """What a command writes that succeeds; it writes nothing to standard error."""
    result = ssduck_(*arguments, **others)
    assert (result.exit_code, result.stderr) == (0, "")
    return result.stdout


def fails(arguments, code, told):
    """What a command wrote that failed: no traceback."""
    result = ssduck_(*arguments)
    assert result.exit_code == code
    assert told in result.stderr
    assert "Traceback" not in result.stderr
    assert result.stderr.startswith("error: ") == (code == 1)
    return result


def environment():
    """That of the process, without colours; the package is that of this checkout."""
    names = ("FORCE_COLOR", "NO_COLOR", "COLUMNS")
    env = {name: value for name, value in os.environ.items() if name not in names}
    return env | {"PYTHONPATH": str(ROOT)}


def start(*arguments, module=("-m", "ssduck"), **others):
    """Start the command in a process of its own."""
    return subprocess.Popen(
        [sys.executable, *module, *arguments],
        stdin=subprocess.PIPE,
        stdout=others.pop("stdout", subprocess.PIPE),
        stderr=subprocess.PIPE,
        env=environment() | others.pop("env", {}),
        text=True,
        **others,
    )


def run(*arguments, **others):
    """Run it: its exit code, what it wrote, and what it complained of."""
    process = start(*arguments, **others)
    out, err = process.communicate(timeout=HANGS)
    return process.returncode, out, err


NO_ROWS = "SELECT id, z + 1 AS top FROM two WHERE z > 100;"
# (program, as a table, as JSON, as CSV)
ANSWERS = [
    ("1+2*3-4/5.;", "6.2\n", 6.2, "value\n6.2\n"),
    ("2 > 1;", "True\n", True, "value\ntrue\n"),
    ("0.1 + 0.2;", "0.3\n", 0.1 + 0.2, "value\n0.30000000000000004\n"),
    ("1234567.25;", "1234567.25\n", 1234567.25, "value\n1234567.25\n"),
    ("-0.0;", "0\n", 0.0, "value\n-0.0\n"),
    ("1e400;", "inf\n", None, "value\ninf\n"),
    (";", "", None, "value\n"),
    ("// nothing but a comment", "", None, "value\n"),
    ("x = 'kept'; x;", "kept\n", "kept", "value\nkept\n"),
    ("'[red]ü, \"😀\" :smile:';", '[red]ü, "😀" :smile:\n', '[red]ü, "😀" :smile:', None),
    ("'two\nlines';", "two\nlines\n", "two\nlines", 'value\n"two\nlines"\n'),
    ("two;", "two\n", "two", "value\ntwo\n"),
    ("[];", "(no rows)\n", [], "value\n"),
    ("[1, 'a', [2.5, True]];", "1\na\n[2.5, True]\n", [1, "a", [2.5, True]], None),
    ("[[1, 2], [3]];", "1  2\n3\n", [[1, 2], [3]], "1,2\n3\n"),
    (
        "SELECT id, z, isRobot FROM two;",
        "id     z  isRobot\n-----  -  -------\nbig    0  False\nsmall  2  False\n",
        [{"id": "big", "z": 0, "isRobot": False}, {"id": "small", "z": 2, "isRobot": False}],
        "id,z,isRobot\nbig,0.0,false\nsmall,2.0,false\n",
    ),
    (
        "SELECT obj, position FROM two WHERE id(this) == 'small' AS list;",
        "small\n[0.25, 0, 2]\n",
        ["small", [0.25, 0, 2]],
        'value\nsmall\n"[0.25, 0.0, 2.0]"\n',
    ),
    (
        "SELECT position FROM two AS list;",
        "   0  0  0\n0.25  0  2\n",
        [[0, 0, 0], [0.25, 0, 2]],
        "0.0,0.0,0.0\n0.25,0.0,2.0\n",
    ),
    (
        "SELECT to(z, id(this)) FROM two;",
        " big  small\n----  -----\n   0   NULL\nNULL      2\n",
        [{"big": 0}, {"small": 2}],
        "big,small\n0.0,\n,2.0\n",
    ),
    (NO_ROWS, "id  top\n--  ---\n(no rows)\n", [], "id,top\n"),
]

# The same for SQL.
SQL_ANSWERS = [
    (
        "SELECT a.name, b.name, above(a, b) AS up FROM entities a, entities b WHERE a.id < b.id",
        "name  name_2  up\n----  ------  ----\nbig   small   True\n",
        [{"name": "big", "name_2": "small", "up": True}],
        "name,name_2,up\nbig,small,true\n",
    ),
    (
        "SELECT 'nan'::DOUBLE AS a, '-inf'::DOUBLE AS b, NULL AS c, 1.50::DECIMAL(5, 2) AS d",
        "  a     b     c    d\n---  ----  ----  ---\nnan  -inf  NULL  1.5\n",
        [{"a": None, "b": None, "c": None, "d": 1.5}],
        "a,b,c,d\n,-inf,,1.5\n",
    ),
    (
        "SELECT DATE '2020-01-31' AS day, {'k': [1, NULL]} AS s, 'x'::BLOB AS b, 2::HUGEINT ** 0 n",
        None,
        [{"day": "2020-01-31", "s": {"k": [1, None]}, "b": "78", "n": 1}],
        'day,s,b,n\n2020-01-31,"{""k"": [1, null]}",78,1.0\n',
    ),
    (
        "SELECT 'a' || chr(10) || chr(27) || '[31m' AS odd",
        "odd\n-----------\na\\n\\x1b[31m\n",
        [{"odd": "a\n\x1b[31m"}],
        'odd\n"a\n\x1b[31m"\n',
    ),
    ("FROM entities SELECT name WHERE FALSE", "name\n----\n(no rows)\n", [], "name\n"),
    ("-- nothing but a comment", "", [], ""),
]

WRITTEN = [
    pytest.param([*flags, program], format, expected, id=f"{format} {program[:60]}")
    for flags, cases in (((), ANSWERS), (("--sql",), SQL_ANSWERS))
    for program, table, plain, values in cases
    for format, expected in (("table", table), ("json", plain), ("csv", values))
    if format == "json" or expected is not None
]


def written(folder, output):
    """How many bytes there are of a record: a batch of ticks has more than 200,000."""
    files = [
        path for path in folder.rglob("*") if path.relative_to(folder).parts[0].startswith(output)
    ]
    return sum(path.stat().st_size for path in files if path.is_file())
