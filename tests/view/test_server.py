"""The server of the page: who may ask, what is answered, and what is refused."""

import hashlib
import json
import re
import struct
import urllib.error
import urllib.request
from functools import partial
from pathlib import Path
from socket import create_connection as socket_to
from time import process_time
from urllib.parse import urljoin, urlsplit

import numpy as np
import pytest

import ssduck
from ssduck.errors import UnknownNameError
from ssduck.simulators.scenes import find_scene

pytest.importorskip("websockets", reason="the extra view is not installed")
from websockets.exceptions import InvalidStatus

from ssduck.view.view import view_scene
from tests.support.viewing import POSES, SCENE, asked, binary, opened, told

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def url(ss):
    page = ss.view()
    yield page.url
    page.close()
    page.close()


def status(url, path=None, **headers):
    """Returns the status of a request."""
    request = urllib.request.Request(url if path is None else path, headers=headers)  # noqa: S310  # its own server
    try:
        with urllib.request.urlopen(request, timeout=30) as reply:  # noqa: S310
            return reply.status
    except urllib.error.HTTPError as error:
        error.close()
        return error.code


def read(url):
    """Returns the text at an address."""
    with urllib.request.urlopen(url, timeout=30) as reply:  # noqa: S310  # its own server
        return reply.read().decode()


@pytest.fixture(scope="module")
def socket(url):
    with opened(url) as socket:
        yield socket


def test_the_page_is_answered_with_its_policy(url):
    with urllib.request.urlopen(url, timeout=30) as reply:  # noqa: S310
        policy, text = reply.headers["Content-Security-Policy"], reply.read().decode()
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "{{" not in text


def test_the_page_and_its_parts_come_from_this_server(url):
    texts = [read(url)]
    names = re.findall(r'(?:src|href)="([^"]+)"', texts[0])
    addresses = [urljoin(url, name) for name in names if name != "data:,"]
    assert {urlsplit(each).path for each in addresses} == {"/page.css", "/page.js"}
    assert {urlsplit(each).netloc for each in addresses} == {urlsplit(url).netloc}
    texts += map(read, addresses)
    # A name of XML, which nothing is loaded from.
    hosts = {host for text in texts for host in re.findall(r"https?://([\w.-]+)", text)}
    assert hosts <= {"www.w3.org"}


@pytest.mark.parametrize("name", ["", "page.js", "page.css", "socket", "nothing"])
@pytest.mark.parametrize("token", ["", "?token=", "?token=wrong", "?token=é"])
def test_nothing_is_answered_without_the_token(url, name, token):
    base = url.partition("?")[0]
    assert status(url, base + name + token.replace("é", "%C3%A9")) == 403


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        ({"Host": "example.org"}, 421),
        ({"Host": "example.org:{port}"}, 421),
        ({"Host": "127.0.0.1.example.org:{port}"}, 421),
        ({"Host": "127.0.0.1:1"}, 421),
        ({"Origin": "http://example.org"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "https://127.0.0.1:{port}"}, 403),
        ({"Host": "localhost:{port}"}, 200),
        ({"Origin": "http://127.0.0.1:{port}"}, 200),
    ],
)
def test_foreign_hosts_and_origins_are_refused(url, headers, expected):
    port = urlsplit(url).port
    assert status(url, **{k: v.format(port=port) for k, v in headers.items()}) == expected


def test_an_address_that_is_none_is_refused(url):
    parts = urlsplit(url)
    with socket_to((parts.hostname, parts.port), timeout=30) as connection:
        connection.sendall(f"GET http://[::1/ HTTP/1.1\r\nHost: {parts.netloc}\r\n\r\n".encode())
        assert connection.recv(100).startswith(b"HTTP/1.1 400 ")


def test_questions_without_a_limit_of_time_are_bounded(socket):
    socket.send(f'{{"type": "seek", "at": 1{"0" * 400}}}')  # no float can have it
    started = process_time()
    for letters in ("a." * 700_000, "/*" * 600_000, "SELECT a, " * 150_000):
        answer = asked(socket, type="complete", text=letters, cursor=len(letters))
        assert answer["completions"] == []
    assert process_time() - started < 2


@pytest.mark.parametrize("origin", ["http://example.org", "http://127.0.0.1:1", "null"])
def test_a_foreign_page_cannot_connect(url, origin):
    with pytest.raises(InvalidStatus) as caught, opened(url, Origin=origin):
        pass
    assert caught.value.response.status_code == 403


@pytest.mark.parametrize(
    ("language", "text", "part"),
    [
        ("sql", "FROM read_csv('/etc/passwd')", "file system operations are disabled"),
        ("sql", "DROP SCHEMA kitchen CASCADE", "one SELECT"),
        ("sql", "SELECT 1; SELECT 2", "one"),
        (
            "selectscript",
            "SELECT this FROM kitchen AS glb('kitchen.glb');",
            "files are switched off",
        ),
        ("selectscript", "eval('1;');", "eval"),
        ("selectscript", "kitchen = 1;", "world"),
        ("selectscript", "kitchen.fridge.__class__;", "__class__"),
    ],
)
def test_programs_of_the_page_are_strict(socket, language, text, part):
    error = asked(socket, type="ask", text=text, language=language)["error"]
    assert part in error["message"]


@pytest.mark.parametrize(
    "question",
    [
        {},
        {"type": 3},
        {"type": "ask"},
        {"type": "ask", "text": 1},
        {"type": "ask", "text": "1;", "language": "python"},
        {"type": "ask", "text": "1;", "language": []},
        {"type": "ask", "text": "1;", "language": {}},
        {"type": "ask", "text": "1;", "language": None},
        {"type": "ask", "text": "1;", "at": []},
        {"type": "ask", "text": "(" * 60_000},
        {"type": "ask", "text": "\ud800"},
        {"type": "download", "format": []},
        {"type": "pick", "entity": 10**30},
        {"type": "pick", "entity": True},
        {"type": []},
        {"type": "pick", "entity": "x"},
        {"type": "pick", "entity": -1},
        {"type": "complete", "text": "S", "cursor": 9},
        {"type": "download", "format": "exe"},
        {"type": "control", "action": "play"},
    ],
)
def test_a_wrong_question_is_an_error_and_the_next_one_is_answered(socket, question):
    assert asked(socket, **question)["error"]["message"]
    assert asked(socket, type="ask", text="1 + 1;")["rows"] == [[2]]


def test_a_query_marks_its_entities(ss, socket):
    program = "SELECT id(this) FROM kitchen WHERE isRobot(this);"
    answer = asked(socket, type="ask", text=program)
    names = [row["id"] for row in ss.eval(program)]
    assert [row[0] for row in answer["rows"]] == names
    ids = [ss["kitchen"][name].id for name in names]
    assert answer["all"] == sorted([id, -1] for id in ids)
    assert len(answer["boxes"]) == len(ids)


def test_a_query_marks_links_by_their_names(ss, socket):
    text = "SELECT full_name FROM links WHERE full_name LIKE 'barrett_4918.arm%' ORDER BY link"
    answer = asked(socket, type="ask", text=text, language="sql")
    robot = ss["kitchen"]["barrett_4918"]
    numbers = [link.number for link in robot.links if link.name.startswith("arm")]
    assert answer["marks"] == [[[robot.id, number]] for number in numbers]


def test_results_of_several_statements_are_told_of(socket):
    answer = asked(socket, type="ask", text="1 + 1; 40 + 2;")
    assert answer["rows"] == [[42]]
    assert "this is the result of the last of 2 statements" in answer["warnings"][0]
    for text in ("x = 1; x + 1;", "40 + 2;"):
        assert not asked(socket, type="ask", text=text)["warnings"]


def test_a_link_name_that_entities_share_is_told_of(ss, socket):
    names = [link.name for entity in ss["kitchen"] for link in getattr(entity, "links", ())]
    shared = max(names, key=names.count)
    answer = asked(socket, type="ask", text=f"'{shared}';")
    assert (answer["marks"], answer["all"]) == ([[]], [])
    assert f"'{shared}' is a link of" in answer["warnings"][0]


def test_a_pair_has_the_line_between_its_nearest_points(ss, socket):
    text = "SELECT a.this, b.this FROM a=kitchen, b=kitchen WHERE id(a.this) == 'table' AND id(b.this) == 'fridge';"
    (line,) = asked(socket, type="ask", text=text)["lines"]
    gap = np.linalg.norm(np.subtract(*line))
    assert gap == pytest.approx(ss.eval("clearance(kitchen.table, kitchen.fridge);"), abs=1e-6)


def test_a_wrong_name_has_its_place_and_the_nearest_right_one(socket):
    text = "SELECT id(this) FROM kitchen WHERE this == kitchen.frigde;"
    error = asked(socket, type="ask", text=text)["error"]
    assert error["suggestions"] == ["fridge"]
    assert text[error["start"] : error["end"]] == "frigde"


def test_names_are_completed(socket):
    text = "SELECT id(kitchen.frid"
    found = asked(socket, type="complete", text=text, cursor=len(text), language="selectscript")
    assert [each[0] for each in found["completions"]] == ["fridge", "fridge_webcam"]


def test_places_are_counted_as_a_page_counts_them(socket):
    """JavaScript's letters are the units of UTF-16: an emoji has two."""
    before, after = "SELECT '😀é😀' AS a,\n'日😀' AS b, ", " FROM kitchen;"
    units = partial(str.encode, encoding="utf-16-le")
    text = f"{before}idd{after}"
    error = asked(socket, type="ask", text=text)["error"]
    assert units(text)[2 * error["start"] : 2 * error["end"]] == units("idd")
    line = text.split("\n")[error["line"] - 1]
    assert units(line)[2 * (error["column"] - 1) :] == units(f"idd{after}")
    cursor = len(units(f"{before}idd")) // 2
    found = asked(socket, type="complete", text=text, cursor=cursor)["completions"]
    assert found[0][:2] == ["id", len(units(before)) // 2]
    end = len(units(text)) // 2
    assert "completions" in asked(socket, type="complete", text=text, cursor=end)
    assert "error" in asked(socket, type="complete", text=text, cursor=end + 1)


@pytest.mark.slow
def test_an_entity_has_its_facts(ss, socket):
    table = ss["kitchen"]["table"]
    answer = asked(socket, type="pick", entity=table.id)
    on_it = "SELECT id(this) FROM kitchen WHERE on(kitchen.table, this) AS list;"
    assert answer["name"] == "table"
    assert [name for name, _ in answer["relations"]["on it"]] == sorted(ss.eval(on_it))


def test_the_poses_are_those_of_the_world_and_only_what_moved_is_sent(ss, url):
    kitchen = ss["kitchen"]
    with opened(url) as socket:
        scene = binary(socket, SCENE)
        head = json.loads(scene[8 : 8 + struct.unpack_from("<II", scene)[1]])
        first = binary(socket, POSES)
        count = struct.unpack_from("<II", first)[1]
        assert count == len(head["links"])
        poses = np.frombuffer(first, "<f4", offset=24 + 4 * count).reshape(-1, 7)
        row = next(i for i, link in enumerate(head["links"]) if link[0] == kitchen["cup_905a"].id)
        np.testing.assert_allclose(poses[row, :3], kitchen["cup_905a"].position, atol=1e-6)
        x, y, z = kitchen["cup_905a"].position
        kitchen["cup_905a"].move([x, y, z + 0.25])
        kitchen.tick()
        moved = binary(socket, POSES)
        rows = np.frombuffer(moved, "<u4", offset=24, count=struct.unpack_from("<II", moved)[1])
        assert rows.tolist() == [row]
        kitchen["cup_905a"].move([x, y, z])


@pytest.mark.slow
def test_nobody_is_told_when_nobody_looks():
    ss = ssduck.load("kitchen")
    page = ss.view()
    assert not ss["kitchen"].observers.are_there
    with opened(page.url) as socket:
        binary(socket, POSES)
        assert ss["kitchen"].observers.are_there
    page.close()
    assert not ss["kitchen"].observers.are_there
    ss.close()


@pytest.mark.slow
def test_a_page_runs_its_scene():
    loaded = []

    def load():
        loaded.append(ssduck.World.load(find_scene("kitchen")))
        return loaded[-1]

    def control(action, value=None):
        return asked(socket, type="control", action=action, value=value)

    def poses_at(condition):
        while True:
            time = struct.unpack_from("<d", binary(socket, POSES), 8)[0]
            if condition(time):
                return time

    with view_scene(load) as page, opened(page.url) as socket:
        told(socket, type="status", playing=False, speed=1.0)
        timestep = loaded[0].timestep
        control("step", 3)
        poses_at(lambda time: time == pytest.approx(3 * timestep))
        control("speed", 2)
        control("play")
        poses_at(lambda time: time > 0.1)
        control("pause")
        control("reset")
        assert poses_at(lambda time: time == 0.0) == 0.0
        assert len(loaded) == 2
        control("step", 10**15)
        poses_at(lambda time: time > 0.0)
        control("pause")
        control("reset")
        assert poses_at(lambda time: time == 0.0) == 0.0
        for action, value in (("speed", 0), ("speed", "x"), ("step", -1), ("jump", None)):
            assert control(action, value)["error"]["message"]
    loaded[-1].close()


def test_a_world_that_is_not_there_has_the_nearest_name(ss):
    with pytest.raises(UnknownNameError, match="kitchen"):
        ss.view("kitchn")


def test_the_bundle_is_that_of_the_sources():
    web = ROOT / "web"
    names = ["build.mjs", "package-lock.json", "package.json"]
    names += [f"src/{path.name}" for path in sorted((web / "src").iterdir())]
    digest = hashlib.sha256()
    for name in names:
        digest.update(f"{name}\n".encode() + (web / name).read_bytes())
    page = ROOT / "ssduck" / "view" / "page"
    assert (page / "sources.sha256").read_text().strip() == digest.hexdigest(), (
        "npm run build in web/"
    )
    assert (page / "index.html").read_bytes() == (web / "src" / "index.html").read_bytes()
    assert (page / "page.js").stat().st_size < 1_200_000
