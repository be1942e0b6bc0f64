"""A sandbox has its effects, shown by probes, and says which one is missing."""

import struct

import pytest

from ssduck.errors import ArgumentError, SandboxError
from ssduck.limits import EFFECTS, Limits
from ssduck.sandbox import SandboxedInterpreter, landlock, seccomp
from ssduck.sandbox.probes import _PROBES, check_present
from ssduck.sandbox.processes import Zygote
from ssduck.sandbox.seccomp import filter_program
from ssduck.sandbox.system_calls import ALLOWED, MACHINES, number_of

LET, KILL, EPERM, ENOSYS = 0x7FFF0000, 0x80000000, 0x50001, 0x50026
ARCHITECTURES = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}


@pytest.fixture
def lacking(zygote):
    """Takes effects away from the workers of a test."""

    def take(*effects):
        zygote.without = effects

    yield take
    zygote.without = ()


def test_a_sandbox_has_all_effects(empty):
    assert empty.effects == {effect: [] for effect in EFFECTS}


@pytest.mark.slow
@pytest.mark.parametrize("effect", EFFECTS)
def test_without_an_effect_each_of_its_probes_gets_through(zygote, lacking, effect):
    """It is refused by the name of the effect, unless that is not required."""
    lacking(effect)
    with pytest.raises(SandboxError, match=f"lacks on this system: {effect} ") as caught:
        SandboxedInterpreter(zygote=zygote)
    others = [name for name in EFFECTS if name != effect]
    assert f"require={others}" in caught.value.message
    with SandboxedInterpreter(zygote=zygote, limits=Limits.strict(require=others)) as ss:
        assert ss.effects == {**{each: [] for each in EFFECTS}, effect: list(_PROBES[effect])}
        assert ss.ask("worker.python", "__import__('os').getcwd()").endswith("scratch")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("layer", "effects", "reason"),
    [
        ("landlock", {"files"}, r"\); Landlock of version 3 is needed .*there is none; use Linux"),
        ("seccomp", set(EFFECTS), r"\); no filter; use Linux"),
        ("limits", {"memory", "time"}, r"\); use Linux"),
    ],
)
def test_without_a_layer_it_is_refused_by_the_names_of_its_effects(
    zygote, lacking, layer, effects, reason
):
    lacking(layer)
    with pytest.raises(SandboxError, match=reason) as caught:
        SandboxedInterpreter(zygote=zygote)
    assert {name for name in EFFECTS if f"{name} (a program can" in caught.value.message} == effects
    others = [name for name in EFFECTS if name not in effects]
    with SandboxedInterpreter(zygote=zygote, limits=Limits.strict(require=others or ())) as ss:
        assert {name for name, holes in ss.effects.items() if holes} == effects


def test_an_unknown_effect_is_an_error_with_the_nearest_name():
    with pytest.raises(ArgumentError, match="did you mean 'network'"):
        Limits.strict(require=("netwrok",))


def test_what_the_system_lacks_is_told():
    holes = {effect: [] for effect in EFFECTS}
    check_present(EFFECTS, holes, ["Landlock is needed"])
    check_present(["files"], {**holes, "network": ["open a socket"]}, [])
    with pytest.raises(SandboxError, match=r"network .*open a socket.*Landlock is needed"):
        check_present(EFFECTS, {**holes, "network": ["open a socket"]}, ["Landlock is needed"])


def test_a_machine_without_a_table_is_told(monkeypatch):
    monkeypatch.setattr("os.uname", lambda: type("Machine", (), {"machine": "riscv64"}))
    assert "x86_64 and aarch64" in seccomp.missing()
    assert "Landlock" in landlock.missing()


def test_a_system_without_descriptors_of_processes_is_told(monkeypatch):
    monkeypatch.delattr("os.pidfd_open")
    with pytest.raises(SandboxError, match="lacks all effects on linux"):
        Zygote()


# -- the filter, run by an interpreter of BPF -------------------------------------------------


def verdict(program, architecture, number, arguments=()):
    """What a filter says of a system call."""
    data = struct.pack("=IIQ6Q", number, architecture, 0, *(*arguments, *[0] * 6)[:6])
    code = list(struct.iter_unpack("HBBI", program))
    at, loaded = 0, 0
    while True:
        operation, yes, no, value = code[at]
        at += 1
        if operation == 0x20:
            (loaded,) = struct.unpack_from("=I", data, value)
        elif operation == 0x54:
            loaded &= value
        elif operation == 0x15:
            at += yes if loaded == value else no
        elif operation == 0x35:
            at += yes if loaded >= value else no
        else:
            assert operation == 0x06
            return value


@pytest.mark.parametrize("machine", MACHINES)
def test_the_filter_lets_what_is_needed_through_and_nothing_else(machine):
    program, architecture = filter_program(machine), ARCHITECTURES[machine]
    needed = {number_of(name, machine) for name in ALLOWED} - {None}
    checked = {number_of(name, machine) for name in seccomp._CHECKED}
    checked.add(number_of("clone", machine))
    for number in range(700):
        if number in needed:
            assert verdict(program, architecture, number) == LET
        elif number not in checked:
            expected = ENOSYS if number >= 424 else EPERM
            assert verdict(program, architecture, number) == expected
    assert len(needed) > 80


@pytest.mark.parametrize("machine", MACHINES)
def test_the_filter_checks_arguments(machine):
    program, architecture = filter_program(machine), ARCHITECTURES[machine]

    def says(name, *arguments):
        return verdict(program, architecture, number_of(name, machine), arguments)

    assert says("clone", 0x3D0F00) == LET  # as threads are started
    assert says("clone", 17) == EPERM  # as processes are
    assert says("clone", 0x3D0F00 | 0x10000000) == EPERM  # in a namespace of users
    assert says("prctl", 15) == LET
    assert says("prctl", 1) == EPERM  # the death signal
    assert says("fcntl", 5, 3) == LET
    assert says("fcntl", 5, 8) == says("fcntl", 5, 10) == EPERM  # who gets signals, and which
    assert says("ioctl", 0, 0x5401) == LET
    assert says("ioctl", 0, 0x5412) == EPERM  # types into a terminal
    assert says("prlimit64", 0, 7) == LET
    assert says("prlimit64", 1, 7) == EPERM
    assert says("socketpair", 1, 0x80001) == LET
    assert says("socketpair", 1, 2) == EPERM


def test_calls_of_other_machines_end_the_process():
    program = filter_program("x86_64")
    assert verdict(program, 0x40000003, 1) == KILL  # int 0x80
    assert verdict(program, ARCHITECTURES["x86_64"], 0x40000000 | 41) == ENOSYS  # x32
    assert verdict(filter_program("aarch64"), ARCHITECTURES["x86_64"], 63) == KILL


def test_the_filter_fits_the_kernel():
    assert len(filter_program("x86_64")) // 8 < 4096
