"""Of the three simulators, pip installs exactly one: whichever has wheels for the machine."""

import tomllib
import warnings
from pathlib import Path

import pytest

packaging = pytest.importorskip("packaging.requirements")

PROJECT = Path(__file__).parents[1] / "pyproject.toml"
VERSIONS = ("3.11", "3.12", "3.13", "3.14", "3.15")
MACHINES = (
    ("linux", "x86_64"), ("linux", "aarch64"), ("win32", "AMD64"), ("win32", "ARM64"),
    ("darwin", "arm64"), ("darwin", "x86_64"), ("freebsd14", "amd64"),
)  # fmt: skip
# What PyPI has of pybullet 3.2.7 and of pybullet-arm64 3.2.8; a universal wheel is of both machines.
PYBULLET = {("3.11", "linux", "x86_64")}
FORK = {
    *(("3.11", *machine) for machine in (MACHINES[0], MACHINES[2], MACHINES[4], MACHINES[5])),
    *(("3.12", *machine) for machine in (MACHINES[0], MACHINES[2], MACHINES[4], MACHINES[5])),
    *(("3.13", *machine) for machine in (MACHINES[0], MACHINES[2], MACHINES[4])),
}


def chosen(requirements, version, system, machine):
    """The simulators that pip takes of some requirements, on a machine."""
    environment = {
        "python_version": version,
        "python_full_version": f"{version}.0",
        "sys_platform": system,
        "platform_machine": machine,
    }
    parsed = map(packaging.Requirement, requirements)
    taken = [one.name for one in parsed if one.marker is None or one.marker.evaluate(environment)]
    return [name for name in taken if name in ("pybullet", "pybullet-arm64", "mujoco")]


@pytest.mark.parametrize("version", VERSIONS)
def test_one_simulator_is_installed_on_each_machine(version):
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    extra = project["optional-dependencies"]["pybullet"]
    for system, machine in MACHINES:
        place = version, system, machine
        expected = (
            "pybullet" if place in PYBULLET else "pybullet-arm64" if place in FORK else "mujoco"
        )
        assert chosen(project["dependencies"], *place) == [expected], place
        # The extra adds PyBullet where it is not there yet: never a second one.
        assert chosen(extra, *place) == (["pybullet"] if expected == "mujoco" else []), place


def test_two_distributions_of_one_module_are_told_of(tmp_path, monkeypatch):
    pytest.importorskip("pybullet")
    from ssduck.simulators import pybullet as simulator

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulator.warn_of_two_distributions()  # this machine has one
    for name, version in (("pybullet", "3.2.7"), ("pybullet_arm64", "3.2.8")):
        folder = tmp_path / f"{name}-{version}.dist-info"
        folder.mkdir()
        described = f"Metadata-Version: 2.1\nName: {name.replace('_', '-')}\nVersion: {version}\n"
        (folder / "METADATA").write_text(described)
    monkeypatch.syspath_prepend(tmp_path)
    message = r"pybullet 3\.2\.7 and pybullet-arm64 3\.2\.8 are both installed.*pip uninstall -y pybullet pybullet-arm64"
    with pytest.warns(UserWarning, match=message):
        simulator.warn_of_two_distributions()
