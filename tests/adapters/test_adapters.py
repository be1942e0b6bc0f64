"""What follows AS: the registry of forms, what a form is given, `evalAs`."""

import importlib.metadata
import time

import pytest

import ssduck
import ssduck.adapters.registry
from ssduck.adapters.registry import all_adapters, find
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    FunctionError,
    LimitError,
    UnknownNameError,
)
from ssduck.schema import TABLES


@pytest.fixture(scope="module")
def kitchen():
    with ssduck.load("kitchen") as ss:
        ss.call_variable("kitchen").step()
        yield ss


@pytest.fixture
def registry(monkeypatch):
    """The registry as it is, whatever a test adds."""
    monkeypatch.setattr(
        ssduck.adapters.registry, "_ADAPTERS", dict(ssduck.adapters.registry._ADAPTERS)
    )


@pytest.mark.parametrize("form", all_adapters(), ids=lambda form: form.names[0])
def test_every_form_is_complete(form):
    assert form.help.endswith(".")
    assert form.tables <= TABLES.keys() - {"entities"}
    for name in form.names:
        assert find(name) is form, "two forms have this name"
        assert find(name.upper()) is form
    with ssduck.Interpreter() as ss:
        assert f"{form.usage}\n    {form.help}" in ss.help("AS")


def test_a_form_of_ones_own(kitchen, registry):
    @ssduck.adapter("tally", "sum_up")
    def tally(selection, least=0, text="rows"):
        """How many rows."""
        return f"{max(least, len(selection.rows))} {text}"

    few = "SELECT id FROM kitchen WHERE isRobot(this) AS"
    assert kitchen.eval(f"{few} tally;") == "4 rows"
    assert kitchen.eval(f"{few} sum_up(2 + 3);") == "5 rows"
    assert kitchen.eval(f"{few} tally(text='robots');") == "4 robots"
    assert tally(type("S", (), {"rows": []})) == "0 rows"
    assert "AS tally | sum_up(least=0, text='rows')\n    How many rows." in kitchen.help("AS")


def test_a_form_by_the_functions_own_name(kitchen, registry):
    @ssduck.adapter()
    def columns(selection):
        return selection.columns

    assert kitchen.eval("SELECT id, to(z(this), 'height') FROM kitchen AS columns;") == (
        "id",
        "height",
    )
    assert kitchen.eval("SELECT id FROM [] AS columns;") == ("id",)


@pytest.mark.parametrize(
    ("settings", "message", "nearest"),
    [
        ({"needs": "entites"}, "there is no input 'entites'", "entities"),
        ({"tables": ["link"]}, "there is no table 'link'", "links"),
    ],
)
def test_a_form_of_an_unknown_input_is_an_error(registry, settings, message, nearest):
    with pytest.raises(UnknownNameError, match=message) as caught:
        ssduck.adapter("tally", **settings)
    assert nearest in caught.value.suggestions


def test_what_a_form_is_given(kitchen, registry):
    seen = []
    ssduck.adapter("keep")(seen.append)
    kitchen.eval(
        "SELECT a.this, b.this, [b.this, a.this] FROM a=kitchen, b=kitchen WHERE above(a.this, b.this) AND NOT (isSensor(a.this) OR isSensor(b.this)) AS keep;"
    )
    (selection,) = seen
    assert len(selection.rows) == 9
    names = [entity.name for entity in selection.entities]
    assert sorted(names) == sorted(set(names))
    assert {"table", "microwave"} < set(names)
    world = kitchen.call_variable("kitchen")
    assert selection.world is world
    assert selection.worlds == [world]
    assert (selection.tick, selection.time) == (world.snapshot.number, world.time)
    assert selection.query.items


@pytest.mark.slow
def test_the_worlds_of_a_query_without_entities(kitchen, registry):
    seen = []
    ssduck.adapter("keep")(seen.append)
    kitchen.eval("SELECT z FROM (SELECT obj FROM kitchen AS list) WHERE False AS keep;")
    assert seen[0].world is kitchen.call_variable("kitchen")
    kitchen.eval("SELECT 1 FROM [1] AS keep;")
    with pytest.raises(ArgumentError, match="one world; those of the query: none"):
        seen[1].world  # noqa: B018


def test_a_past_tick(kitchen, registry):
    seen = []
    ssduck.adapter("keep")(seen.append)
    kitchen.eval("SELECT obj FROM kitchen{0.0} AS keep;")
    kitchen.eval("SELECT z FROM kitchen{0.0} AS keep;")
    kitchen.eval("SELECT obj FROM kitchen{} AS keep;")
    assert [selection.time for selection in seen[:2]] == [0.0, 0.0]
    assert {e.state.time for e in seen[0].entities} == {0.0}
    with pytest.raises(ArgumentError, match="several ticks of 'kitchen'"):
        seen[2].world  # noqa: B018


def test_groups_and_paths_are_selections_of_their_own(kitchen, registry):
    ssduck.adapter("count")(lambda selection: len(selection.rows))
    by_kind = "SELECT id FROM kitchen GROUP BY type AS"
    assert kitchen.eval(f"{by_kind} count;") == {
        kind: sum(e.kind == kind for e in kitchen.call_variable("kitchen"))
        for kind in ("sensor", "robot", "kinbody")
    }
    ssduck.adapter("later", needs="query")(lambda selection: len(selection.rows))
    assert kitchen.eval(f"{by_kind} later;") == kitchen.eval(f"{by_kind} count;")
    path = "SELECT n FROM [0] START WITH n = 0 CONNECT BY n = n + 1 STOP WITH n == 3 AS count;"
    assert kitchen.eval(path) == [4]


def test_a_lazy_form_is_given_no_rows_that_it_does_not_read(kitchen, registry):
    calls = []
    with ssduck.Interpreter() as ss:
        ss.add_function("seen", lambda n: calls.append(n) or n)
        ssduck.adapter("none", needs="query")(lambda selection: len(selection.query.items))
        ssduck.adapter("few", needs="query")(lambda selection: selection.head(2))
        ssduck.adapter("all", needs="query")(lambda s: (s.head(1), s.rows, s.rows, s.head(1)))
        query = "SELECT seen(this) FROM [1, 2, 3, 4]"
        assert ss.eval(f"{query} AS none;") == 1
        assert calls == []
        assert ss.eval(f"{query} AS few;") == [(1,), (2,)]
        assert calls == [1, 2]
        assert ss.eval(f"{query} LIMIT 1 AS few;") == [(1,)]
        del calls[:]
        every = [(1,), (2,), (3,), (4,)]
        assert ss.eval(f"{query} AS all;") == ([(1,)], every, every, [(1,)])
        assert calls == [1, 1, 2, 3, 4]


@pytest.mark.parametrize("limit", ["1.5", "-1", "'x'", "True"])
def test_a_lazy_form_minds_the_limit(kitchen, registry, limit):
    ssduck.adapter("peek", needs="query")(lambda selection: selection.head(2))
    assert kitchen.eval("SELECT z FROM kitchen LIMIT 1 AS peek;") == [(1.499,)]
    with pytest.raises(EvaluationError, match="LIMIT takes a whole number"):
        kitchen.eval(f"SELECT z FROM kitchen LIMIT {limit} AS peek;")


def test_a_lazy_form_reads_before_it_returns(kitchen, registry):
    kept = []
    ssduck.adapter("keep", needs="query")(kept.append)
    kitchen.eval("SELECT z FROM kitchen AS keep;")
    for late in (lambda: kept[0].rows, lambda: kept[0].head(1)):
        with pytest.raises(ArgumentError, match="the query has ended"):
            late()


def test_a_form_that_needs_entities(kitchen, registry):
    ssduck.adapter("names", needs="entities")(lambda s: [e.name for e in s.entities])
    assert kitchen.eval("SELECT obj FROM kitchen WHERE isRobot(this) AS names;") == [
        "fridge",
        "cooker",
        "barrett_4918",
        "roomba_625x",
    ]
    assert kitchen.eval("SELECT id FROM kitchen WHERE False AS names;") == []
    with pytest.raises(ArgumentError, match="select them as obj") as caught:
        kitchen.eval("SELECT id FROM kitchen AS names;")
    assert caught.value.span is not None


def test_a_form_that_needs_columns(kitchen, registry):
    ssduck.adapter("table_of", needs="columns")(lambda s: s.columns)
    with pytest.raises(ArgumentError, match="two columns have the name 'id'"):
        kitchen.eval("SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen AS table_of;")


BAD = [
    ("SELECT id FROM kitchen AS lst;", UnknownNameError, "no result form 'lst'.*'list'"),
    (
        "SELECT id FROM kitchen AS list(1);",
        ArgumentError,
        "too many positional.*its usage: AS list",
    ),
    ("SELECT id FROM kitchen AS value(x=1);", ArgumentError, "unexpected keyword.*'x'"),
    ("SELECT id FROM kitchen AS breaks;", FunctionError, "AS breaks: ZeroDivisionError"),
    ("SELECT id FROM kitchen AS complains;", ArgumentError, "AS complains: no cup"),
]


@pytest.mark.parametrize(("program", "error", "message"), BAD)
def test_errors_say_where_and_leave_variables(kitchen, registry, program, error, message):
    @ssduck.adapter("breaks")
    def breaks(selection):
        return 1 / 0

    @ssduck.adapter("complains")
    def complains(selection):
        raise ArgumentError("no cup")

    with pytest.raises(error, match=message) as caught:
        kitchen.eval(f"kept = 1; {program}")
    span = caught.value.span
    assert f"kept = 1; {program}"[span.start : span.end] == program.partition(" AS ")[2][:-1]
    with pytest.raises(UnknownNameError):
        kitchen.call_variable("kept")


@pytest.mark.slow
def test_time_is_up_for_forms_too(kitchen, registry):
    made = []

    @ssduck.adapter("slow", needs="entities")
    def slow(selection):
        made.append(selection.entities)
        time.sleep(0.3)

    with ssduck.Interpreter(limits=ssduck.Limits(seconds=0.2)) as ss:
        ss.add_variable("kitchen", kitchen.call_variable("kitchen"))
        with pytest.raises(LimitError, match=r"took more than 0\.2 s"):
            ss.eval("SELECT obj FROM kitchen GROUP BY id AS slow;")
    assert len(made) <= 1  # of 37 groups


@pytest.mark.parametrize(
    ("name", "told"),
    [
        *((name, f"AS {name} is one of ssduck's own") for name in ("list", "dict", "value")),
        ("two words", "cannot be a form's name"),
        (len, r"@ssduck\.adapter\(\)"),  # a decorator without brackets
    ],
)
def test_what_is_no_name_of_a_form(registry, name, told):
    with pytest.raises(ArgumentError, match=told):
        ssduck.adapter(name)(len)


def test_forms_of_packages(kitchen, registry, monkeypatch):
    def points(group):
        assert group == "ssduck.adapters"
        make = importlib.metadata.EntryPoint
        return [
            make("how_many", "builtins:len", group),
            make("gone", "no_such_package:form", group),
            make("nothing", "math:pi", group),
        ]

    monkeypatch.setattr(ssduck.adapters.registry, "entry_points", points)
    with pytest.raises(FunctionError, match="AS how_many: TypeError"):  # a selection has no len
        kitchen.eval("SELECT id FROM kitchen AS how_many;")
    with pytest.raises(ArgumentError, match="AS gone: no_such_package:form cannot be loaded"):
        kitchen.eval("SELECT id FROM kitchen AS gone;")
    with pytest.raises(ArgumentError, match="AS nothing: math:pi is no function"):
        kitchen.eval("SELECT id FROM kitchen AS nothing;")
    told = kitchen.help("AS")
    assert "AS how_many" in told
    assert "AS gone" not in told
    with pytest.raises(UnknownNameError, match="did you mean 'how_many'"):
        kitchen.eval("SELECT id FROM kitchen AS how_man;")


# -- evalAs --------------------------------------------------------------------------------------


class Spelled(ssduck.Interpreter):
    """Forms of its own, as the tutorial's section 10 makes them."""

    def evalAs(self, form, select, elements, names, where):  # noqa: N802
        if form == "pairs":
            return self.pairs(select, elements, names, where)
        form = "list" if form == "as_list" else form
        return super().evalAs(form, select, elements, names, where)

    def pairs(self, select, rows, names, where):
        found = []
        for elements in rows:
            if where == [] or self.eval(where, elements, names):
                values = self.eval(select, elements, names)
                told = [(f[1], [self.eval(p, elements, names) for p in f[2]]) for f in select]
                found.append((values, told))
        return found


@pytest.fixture(params=[False, True], ids=["as SQL", "row by row"])
def spelled(request):
    with Spelled(row_by_row=request.param) as ss:
        ss.add_function("double", lambda n: 2 * n)
        yield ss


SPELLED = [
    ("SELECT double(this) FROM [1, 2]", [(2, [("double", [1])]), (4, [("double", [2])])]),
    ("SELECT double FROM [1, 2] WHERE this > 1", [(4, [("double", [2])])]),
    (
        "SELECT a.this, b.this FROM a=[1], b=[2, 3] WHERE a.this + b.this == 4",
        [([1, 3], [("a", [1]), ("b", [3])])],
    ),
    ("SELECT to(double(this), 'twice') FROM [3]", [((6, "twice"), [("to", [6, "twice"])])]),
    ("SELECT this FROM []", []),
]


@pytest.mark.parametrize(("query", "expected"), SPELLED)
def test_a_subclass_goes_through_the_rows(spelled, query, expected):
    assert spelled.eval(f"{query} AS pairs;") == expected


def test_other_forms_are_as_ever(spelled):
    assert spelled.eval("SELECT double FROM [1, 2] AS list;") == [2, 4]
    assert spelled.eval("SELECT double FROM [1, 2] AS as_list;") == [2, 4]
    assert spelled.eval("SELECT double FROM [1];") == [{"double": 2}]
    with pytest.raises(UnknownNameError, match="no result form 'as_lst'"):
        spelled.eval("SELECT double FROM [1] AS as_lst;")
