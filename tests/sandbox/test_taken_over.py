"""Python that runs in a worker, as if a stranger had taken it over, reaches nothing."""

import os
import resource
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

import ssduck
from ssduck.errors import LimitError, SandboxError, SelectScriptError
from ssduck.limits import Limits
from ssduck.sandbox import SandboxedInterpreter, opening
from ssduck.sandbox.seccomp import _CHECKED
from ssduck.sandbox.system_calls import ALLOWED, MACHINES, number_of

CALL = "__import__('ctypes').CDLL(None, use_errno=True)"
RAW = f"""
import ctypes, os
libc = {CALL}
libc.syscall.restype = ctypes.c_long
value = libc.syscall({{}})
result = "through" if value >= 0 else os.strerror(ctypes.get_errno())
"""
# What is tried; the wall answers with an error of permission. {host} is the number of the host's
# process, {outside} a file of the host.
ATTEMPTS = {
    "reads a secret": "open('/etc/shadow').read()",
    "reads a public file": "open('/etc/passwd').read()",
    "reads the host's file": "open('{outside}').read()",
    "lists a home": "__import__('os').listdir('/root')",
    "lists the processes": "__import__('os').listdir('/proc')",
    "lists the control groups": "__import__('os').listdir('/sys/fs/cgroup')",
    "reads the connections": "open('/proc/self/net/tcp').read()",
    "reads the local sockets": "open('/proc/self/net/unix').read()",
    "reads the mounts": "open('/proc/self/mountinfo').read()",
    "reads the host's environment": "open('/proc/{host}/environ').read()",
    "reads the host's memory": "open('/proc/{host}/mem', 'rb').read(1)",
    "reads the parent's memory": "open(f'/proc/{{__import__(\"os\").getppid()}}/mem', 'rb').read(1)",
    "writes the host's file": "open('{outside}', 'a')",
    "cuts the host's file": "__import__('os').truncate('{outside}', 0)",
    "removes the host's file": "__import__('os').unlink('{outside}')",
    "renames the host's file": "__import__('os').rename('{outside}', 'mine')",
    "links the host's file": "__import__('os').link('{outside}', 'mine')",
    "links by name": "__import__('os').symlink('{outside}', 'mine')",
    "changes its mode": "__import__('os').chmod('{outside}', 0o777)",
    "changes its owner": "__import__('os').chown('{outside}', 1, 1)",
    "changes its times": "__import__('os').utime('{outside}', (0, 0))",
    "writes beside its folder": "open('../new', 'w')",
    "writes the library": "open(__import__('ssduck').__file__, 'a')",
    "makes a folder": "__import__('os').mkdir('/tmp/stolen-by-a-worker')",
    "makes a pipe": "__import__('os').mkfifo('pipe')",
    "opens shared memory": "open('/dev/shm/stolen-by-a-worker', 'w')",
    "opens the terminal": "open('/dev/tty')",
    "runs a shell": "__import__('subprocess').run(['sh', '-c', 'true'])",
    "replaces its program": "__import__('os').execv('/bin/sh', ['sh'])",
    "spawns": "__import__('os').posix_spawn('/bin/true', ['true'], {})",
    "forks": "__import__('os').fork()",
    "connects": "__import__('socket').create_connection(('127.0.0.1', {port}), 1)",
    "listens": "__import__('socket').create_server(('127.0.0.1', 0))",
    "opens a local socket": "__import__('socket').socket(__import__('socket').AF_UNIX)",
    "pairs datagrams": "__import__('socket').socketpair(type=__import__('socket').SOCK_DGRAM)",
    "kills the host": "__import__('os').kill({host}, 9)",
    "kills its parent": "__import__('os').kill(__import__('os').getppid(), 9)",
    "asks whether the host lives": "__import__('os').kill({host}, 0)",
    "kills all it can": "__import__('os').kill(-1, 9)",
    "has the kernel signal the host": (
        "__import__('fcntl').fcntl(0, __import__('fcntl').F_SETOWN, {host})"
    ),
    "limits the host": "__import__('resource').prlimit({host}, 7, (0, 0))",
    "slows the host": "__import__('os').setpriority(0, {host}, 19)",
    "binds the host to a processor": "__import__('os').sched_setaffinity({host}, [0])",
    "raises its memory": "__import__('resource').setrlimit(9, (-1, -1))",
    "takes 4 GB": "bytearray(4 << 30)",
    "maps 100 GB": "__import__('mmap').mmap(-1, 100 << 30)",
    "writes a large file": "open('big', 'wb').write(bytes(200 << 20))",
}
# System calls by number, on x86-64: those that Python has not.
CALLS = {
    "ptrace": "101, 16, {host}, 0, 0",
    "process_vm_readv": "310, {host}, 0, 1, 0, 1, 0",
    "mount": "165, 0, 0, 0, 0, 0",
    "keyctl": "250, 0, 0, 0, 0, 0",
    "bpf": "321, 0, 0, 0",
    "userfaultfd": "323, 0",
    "io_uring_setup": "425, 1, 0",
    "memfd_create": "319, b'x', 0",
    "perf_event_open": "298, 0, 0, -1, -1, 0",
    "tgkill": "234, {host}, {host}, 0",
    "rt_sigqueueinfo": "129, {host}, 0, b'\\\\0' * 128",
    "pidfd_open": "434, {host}, 0",
    "pidfd_send_signal": "424, 0, 0, 0, 0",
    "shmget": "29, 0, 4096, 0o1600",
    "unshare": "272, 0x10000000",
    "clone": "56, 17, 0, 0, 0, 0",
    "clone3": "435, 0, 0",
    "personality": "135, 0xffffffff",
    "prctl of its death": "157, 1, 0, 0, 0, 0",
    "ioctl of a terminal": "16, 0, 0x5412, 0",
    "open_by_handle_at": "304, 0, 0, 0",
    "a call of x32": "0x40000000 + 39",
    "a call of tomorrow": "600",
}


@pytest.fixture(scope="module")
def outside(tmp_path_factory):
    """A file of the host."""
    path = tmp_path_factory.mktemp("host") / "private"
    path.write_text("secret")
    return path


def has_all(outside):
    """Whether the host's file is as it was, alone in its folder."""
    names = [path.name for path in outside.parent.iterdir()]
    return outside.read_text() == "secret" and names == ["private"]


@pytest.mark.parametrize("name", ATTEMPTS)
def test_python_reaches_nothing(empty, outside, name):
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    with socket.create_server(("127.0.0.1", 0)) as server:
        code = ATTEMPTS[name].replace("{host}", str(os.getpid()))
        code = code.replace("{outside}", str(outside)).replace("{{", "{").replace("}}", "}")
        code = code.replace("{port}", str(server.getsockname()[1]))
        with pytest.raises((SandboxError, LimitError)) as caught:
            empty.ask("worker.python", code)
    known = ("Permission", "not permitted", "not implemented", "memory", "too large", "not allowed")
    known += ("No such file or directory: '/dev/tty'", "No such device")
    assert any(word in caught.value.message for word in known)
    assert has_all(outside)
    assert resource.getrlimit(resource.RLIMIT_NOFILE) == limits
    assert empty.eval("1 + 1;") == 2


@pytest.mark.skipif(os.uname().machine != "x86_64", reason="the numbers are of x86-64")
@pytest.mark.parametrize("name", CALLS)
def test_system_calls_are_refused(empty, name):
    arguments = CALLS[name].replace("{host}", str(os.getpid()))
    answer = empty.ask("worker.python", RAW.format(arguments))
    assert answer in ("Operation not permitted", "Function not implemented")
    assert empty.eval("1 + 1;") == 2


@pytest.mark.skipif(os.uname().machine not in MACHINES, reason="there is no filter")
def test_the_kernel_refuses_all_other_calls(empty):
    machine = os.uname().machine
    checked = (*_CHECKED, "clone")
    needed = {number_of(name, machine) for name in (*ALLOWED, *checked)}
    if machine == "x86_64":
        needed |= {335, 336}  # of debuggers, which the kernel lets through any filter
    others = [number for number in range(520) if number not in needed]
    code = RAW.format("0x40000000") + (
        f"result = {{n for n in {others} if libc.syscall(n, -1, -1, -1, -1, -1, -1) >= 0 "
        "or ctypes.get_errno() not in (1, 38)}\nresult = list(result)\n"
    )
    assert len(others) > 300
    assert empty.ask("worker.python", code) == []


def test_a_shell_is_not_started(empty, tmp_path):
    assert empty.ask("worker.python", f"__import__('os').system('touch {tmp_path}/x')") != 0
    assert list(tmp_path.iterdir()) == []


def test_threads_are_allowed(empty):
    code = """
import threading
found = []
threads = [threading.Thread(target=found.append, args=(i,)) for i in range(8)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
result = sorted(found)
"""
    assert empty.ask("worker.python", code) == list(range(8))


@pytest.mark.slow
def test_its_scratch_folder_is_its_own_and_bounded(zygote):
    with SandboxedInterpreter(zygote=zygote) as ss:
        assert ss.ask("worker.python", "open('mine', 'w').write('x')") == 1
        folder = ss.ask("worker.python", "__import__('os').getcwd()")
        assert [path.name for path in Path(folder).iterdir()] == ["mine"]
        fill = "[open(f'f{i}', 'wb').write(bytes(50 << 20)) for i in range(20)]"
        with pytest.raises(LimitError, match="filled the disk"):
            ss.ask("worker.python", fill)
        assert not Path(folder).exists()
        with pytest.raises(LimitError, match="filled the disk"):
            ss.ask("worker.python", "[open(f'f{i}', 'w') and None for i in range(2000)]")
        for code in (HIDDEN, DEEP, FAR, MAPPED):
            with pytest.raises(LimitError, match="filled the disk"):
                ss.ask("worker.python", code)
        assert ss.eval("1;") == 1
        ss.ask("worker.python", LOCKED)
    folders = [path.name for path in Path(folder).parents[1].iterdir()]
    own = int(Path(folder).parent.name.removeprefix("worker"))
    assert not any(f"worker{number}" in folders for number in range(own, own + 7))


# Files that are open and have no name, folders in folders, files of paths too long for the kernel,
# and files without a name that are in memory, by a page, and not open.
HIDDEN = """
import os
files = []
for i in range(10):
    files.append(open("hidden", "wb"))
    os.unlink("hidden")
    files[-1].write(bytes(50 << 20))
"""
DEEP = """
import os
for i in range(20000):
    os.mkdir("d")
    os.chdir("d")
"""
FAR = """
import os, time
for i in range(20):
    os.mkdir("d" * 250)
    os.chdir("d" * 250)
[open(f"f{i}", "wb").write(bytes(10 << 20)) for i in range(30)]
time.sleep(1)
"""
# Folders that their owner cannot read, unless it is the superuser.
LOCKED = """
import os
os.makedirs("d/d")
os.mkdir("d/d/d", 0o300)
open("d/d/d/x", "w").close()
os.mkdir("d/d/e", 0)
"""
MAPPED = f"""
import ctypes, os, time
libc = {CALL}
libc.mmap.restype = ctypes.c_void_p
libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long]
for i in range(8):
    file = os.open("mapped", os.O_RDWR | os.O_CREAT)
    os.write(file, bytes(50 << 20))
    assert libc.mmap(None, 4096, 1, 2, file, 0) < 1 << 63
    os.unlink("mapped")
    os.close(file)
time.sleep(1)
"""


@pytest.mark.slow
def test_a_bomb_of_threads_ends_the_process(zygote):
    bomb = """
import threading, time
threading.stack_size(64 * 1024)
def wait(): time.sleep(60)
[threading.Thread(target=wait, daemon=True).start() for i in range(500)]
time.sleep(5)
"""
    with SandboxedInterpreter(zygote=zygote) as ss:
        with pytest.raises(LimitError, match="many threads"):
            ss.ask("worker.python", bomb)
        assert ss.eval("1;") == 1


@pytest.mark.slow
def test_nothing_runs_between_questions(zygote):
    count = """
import threading
worker.count = 0
def work():
    while True: worker.count += 1
threading.Thread(target=work, daemon=True).start()
"""
    with SandboxedInterpreter(zygote=zygote) as ss:
        ss.ask("worker.python", count)
        while state_of(ss)[0] != "T":  # it takes the signal when it is scheduled
            time.sleep(0.01)
        used = state_of(ss)[11:13]
        time.sleep(0.2)
        assert state_of(ss)[11:13] == used
        first = ss.ask("worker.python", "worker.count")
        assert ss.ask("worker.python", "__import__('time').sleep(0.1) or worker.count") > first


def state_of(ss):
    """What the kernel says of its process: its state, and others."""
    text = Path(f"/proc/{ss._worker._pid}/stat").read_text(encoding="ascii")
    return text.rpartition(")")[2].split()


def test_descriptors_are_its_connection_only(empty):
    code = "{n: __import__('os').readlink(f'/proc/self/fd/{n}') for n in __import__('os').listdir('/proc/self/fd') if __import__('os').path.exists(f'/proc/self/fd/{n}')}"
    targets = empty.ask("worker.python", code)
    assert {targets[str(n)] for n in range(3)} == {"/dev/null"}
    files = [path for path in targets.values() if path.startswith("/") and path != "/dev/null"]
    assert all(path.startswith("/proc/") for path in files)


@pytest.mark.slow
def test_the_environment_has_no_secret(monkeypatch):
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setenv("LANG", "C.UTF-8")
    code = """
import json, os, sys
from tests.support.taken_over import HookedZygote
from ssduck.sandbox import SandboxedInterpreter
zygote = HookedZygote()
with SandboxedInterpreter(zygote=zygote) as ss:
    print(json.dumps(ss.ask("worker.python", "dict(__import__('os').environ)")))
zygote.close()
"""
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "secret" not in told.stdout
    assert '"LANG": "C.UTF-8"' in told.stdout


@pytest.mark.slow
def test_a_scene_reads_its_folder_and_no_more(zygote, tmp_path):
    folder = tmp_path / "scene"
    folder.mkdir()
    (tmp_path / "secret.obj").write_text("v 0 0 0")
    (folder / ".hidden").write_text("secret")
    (folder / "link").symlink_to(tmp_path)
    (folder / "box.urdf").write_text(
        '<robot name="box"><link name="base"><collision><geometry><box size="1 1 1"/>'
        "</geometry></collision></link></robot>"
    )
    limits = Limits.strict()
    with opening.load(folder / "box.urdf", limits=limits, zygote=zygote) as ss:
        assert ss.eval("SELECT id(this) FROM box AS list;") == ["box"]
        assert ss.ask("worker.python", f"len(open('{folder}/box.urdf').read())") > 10
        for path in (tmp_path / "secret.obj", folder / ".hidden", folder / "link" / "secret.obj"):
            with pytest.raises(SandboxError, match="Permission denied"):
                ss.ask("worker.python", f"open('{path}').read()")


@pytest.mark.slow
def test_a_link_beside_a_record_leads_nowhere(zygote, tmp_path):
    with ssduck.load("kitchen", tmp_path / "run.duckdb") as live:
        live.run(0.02)
    (tmp_path / "secret").write_text("secret")
    (tmp_path / "run.duckdb.wal").unlink(missing_ok=True)
    (tmp_path / "run.duckdb.wal").symlink_to(tmp_path / "secret")
    with pytest.raises(SelectScriptError, match="is a symbolic link"):
        opening.open_record(tmp_path / "run.duckdb", zygote=zygote)
