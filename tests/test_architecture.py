"""How the package is laid out: no cycles of imports, small packages, short modules.

Which package may import which is said in `pyproject.toml`, and kept by `lint-imports`.
"""

from collections import Counter
from pathlib import Path

import grimp
import pytest

import ssduck
from ssduck.recording.replay.replayed_world import CopiedWorld, ReplayedWorld
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.stepping import SteppedWorld
from ssduck.world.ticking import Ticker

PACKAGE = Path(ssduck.__file__).parent
FRONTS = {"openrave", "snapshot", "translate", "udfs"}
# A handle knows its world, which makes handles: it imports the other for annotations only.
OF_HANDLES = [
    ("ssduck.world.entities", "ssduck.world.world"),
    ("ssduck.world.handles", "ssduck.world.world"),
    ("ssduck.world.handles", "ssduck.world.entities"),
]


@pytest.fixture(scope="module")
def imports():
    return grimp.build_graph("ssduck", cache_dir=None)


def cycles(graph, without=()):
    """The sets of modules that import each other, by Tarjan's algorithm."""
    edges = {
        module: graph.find_modules_directly_imported_by(module) - {module}
        for module in graph.modules
    }
    for importer, imported in without:
        edges[importer] = edges[importer] - {imported}
    numbers, lowest, stack, found = {}, {}, [], []

    def visit(module):
        numbers[module] = lowest[module] = len(numbers)
        stack.append(module)
        for other in edges[module]:
            if other not in numbers:
                visit(other)
            if other in stack:
                lowest[module] = min(lowest[module], lowest[other])
        if lowest[module] == numbers[module]:
            cut = stack.index(module)
            if len(stack) - cut > 1:
                found.append(frozenset(stack[cut:]))
            del stack[cut:]

    for module in edges:
        if module not in numbers:
            visit(module)
    return found


def test_cycles_are_found():
    graph = grimp.ImportGraph()
    for pair in ("ab", "bc", "ca", "cd", "de", "ed", "ef"):
        graph.add_import(importer=pair[0], imported=pair[1])
    assert set(cycles(graph)) == {frozenset("abc"), frozenset("de")}
    assert cycles(graph, [("c", "a"), ("e", "d")]) == []


def test_only_a_handle_and_its_world_import_each_other(imports):
    (found,) = cycles(imports)
    assert found == {module for pair in OF_HANDLES for module in pair}
    assert cycles(imports, OF_HANDLES) == []


@pytest.mark.slow
def test_nothing_imports_in_circles_when_it_runs():
    graph = grimp.build_graph("ssduck", cache_dir=None, exclude_type_checking_imports=True)
    assert len(graph.modules) > 100
    assert cycles(graph) == []


def private_overrides(base):
    """What subclasses of a class define anew that is private in a class above them."""
    found = set()
    for kind in base.__subclasses__():
        private = {name for name in vars(kind) if name.startswith("_") and name[1] != "_"}
        above = {name for parent in kind.__mro__[1:-1] for name in vars(parent)}
        found |= {f"{kind.__name__}.{name}" for name in private & above if name != "_abc_impl"}
        found |= private_overrides(kind)
    return found


def test_kinds_of_worlds_override_nothing_private():
    class Base:
        def _take(self): ...

    class Derived(Base):
        def _take(self): ...

        def _other(self): ...

    assert private_overrides(Base) == {"Derived._take"}
    assert {CopiedWorld, BatchWorld} <= {
        *ReplayedWorld.__subclasses__(),
        *ssduck.World.__subclasses__(),
    }
    for base in (SteppedWorld, Ticker):
        assert private_overrides(base) == set()


# The largest number of lines of each package, and of the modules at the top. What a change adds, it
# takes out, there or elsewhere: the sum falls. A budget is lowered when a package has become smaller.
BUDGETS = {
    "": 2_296,
    "adapters": 4_550,
    "cli": 1_360,
    "columns": 1_278,
    "database": 6_261,
    "demos": 1_495,
    "geometry": 8_593,
    "gym": 2_706,
    "interchange": 2_939,
    "interpreter": 15_845,
    "lakes": 2_905,
    "language": 6_072,
    "logic": 627,
    "mcp": 492,
    "recording": 8_690,
    "render": 1_098,
    "sandbox": 3_716,
    "shell": 489,
    "simulators": 10_746,
    "sql": 7_228,
    "view": 2_313,
    "world": 6_260,
}


def test_each_package_keeps_within_its_budget():
    lines = Counter()
    for path in PACKAGE.rglob("*.py"):
        inner = path.relative_to(PACKAGE).parts
        package = inner[0] if len(inner) > 1 else ""
        lines[package] += len(path.read_text(encoding="utf-8").splitlines())
    assert lines.keys() == BUDGETS.keys()
    assert {name: count for name, count in lines.items() if count > BUDGETS[name]} == {}


def test_the_manual_keeps_within_its_budget():
    pages = [*(PACKAGE.parent / "docs").rglob("*.md")]
    assert len(pages) > 10
    assert sum(len(page.read_text(encoding="utf-8").splitlines()) for page in pages) <= 7_000


def test_few_modules_stand_at_the_top():
    modules = {path.stem for path in PACKAGE.glob("*.py")} - {"__init__", "__main__"}
    assert modules >= FRONTS
    assert len(modules) <= 10


def test_no_package_has_more_than_30_modules():
    counts = Counter(path.parent for path in PACKAGE.rglob("*.py") if path.stem != "__init__")
    assert len(counts) > 10
    assert max(counts.values()) <= 30


def test_no_module_has_more_than_600_lines():
    lengths = {
        path.as_posix(): len(path.read_text(encoding="utf-8").splitlines())
        for name in ("ssduck", "benchmarks", "examples", "tools")
        for path in (PACKAGE.parent / name).rglob("*.py")
    }
    assert len(lengths) > 200
    assert [name for name, length in lengths.items() if length > 600] == []


def test_no_test_file_has_more_than_700_lines():
    folder = Path(__file__).parent
    lengths = {
        path.relative_to(folder).as_posix(): len(path.read_text(encoding="utf-8").splitlines())
        for path in folder.rglob("*.py")
    }
    assert len(lengths) > 90
    assert [name for name, length in lengths.items() if length > 700] == []


def test_each_package_says_what_it_is_for_and_has_what_it_offers():
    packages = [path.parent for path in PACKAGE.rglob("__init__.py")]
    assert len(packages) > 10
    for folder in packages:
        name = ".".join(("ssduck", *folder.relative_to(PACKAGE).parts))
        package = __import__(name, fromlist=["__doc__"])
        assert package.__doc__
        for offered in getattr(package, "__all__", ()):
            assert getattr(package, offered) is not None
            assert offered in dir(package)
        with pytest.raises(AttributeError, match="nothing_like_that"):
            package.nothing_like_that  # noqa: B018


@pytest.mark.parametrize("front", sorted(FRONTS))
def test_fronts_have_what_they_offer(front):
    module = __import__(f"ssduck.{front}", fromlist=["__all__"])
    assert module.__doc__
    assert all(hasattr(module, name) for name in module.__all__)
    assert len(module.__all__) > 0
