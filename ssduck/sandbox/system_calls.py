"""The numbers of Linux's system calls on x86-64 and on 64-bit ARM, and those a worker may make."""

from __future__ import annotations

# By the name of the machine, as `os.uname` gives it.
MACHINES = ("x86_64", "aarch64")

# What a process with threads needs that computes, and reads files. Of each call: its name, and its
# number on both machines. What is not here is refused: sockets, new processes and programs,
# signals, shared memory, kernel facilities, changes of owners, modes, times, links, priorities.
_ALLOWED = """
read 0 63; write 1 64; open 2 -; close 3 57; stat 4 -; fstat 5 80; lstat 6 -; poll 7 -; lseek 8 62
mmap 9 222; mprotect 10 226; munmap 11 215; brk 12 214; rt_sigaction 13 134
rt_sigprocmask 14 135; rt_sigreturn 15 139; pread64 17 67; pwrite64 18 68; readv 19 65
writev 20 66; access 21 -; pipe 22 -; select 23 -; sched_yield 24 124; mremap 25 216; msync 26 227
madvise 28 233; dup 32 23; dup2 33 -; nanosleep 35 101; getitimer 36 102; setitimer 38 103
getpid 39 172; sendto 44 206; recvfrom 45 207; exit 60 93;
 uname 63 160; fsync 74 82; fdatasync 75 83; ftruncate 77 46
getdents 78 -; getcwd 79 17; chdir 80 49; fchdir 81 50; rename 82 -; mkdir 83 -; rmdir 84 -
unlink 87 -; readlink 89 -; umask 95 166; gettimeofday 96 169; getrlimit 97 163; getrusage 98 165
sysinfo 99 179; times 100 153; getuid 102 174; getgid 104 176; geteuid 107 175; getegid 108 177
getppid 110 173; getgroups 115 158; getresuid 118 148; getresgid 120 150; rt_sigpending 127 136
rt_sigtimedwait 128 137; rt_sigsuspend 130 133; sigaltstack 131 132; statfs 137 43; fstatfs 138 44
sched_getparam 143 121; sched_getscheduler 145 120; sched_get_priority_max 146 125
sched_get_priority_min 147 126; gettid 186 178; time 201 -; futex 202 98
sched_getaffinity 204 123; getdents64 217 61; set_tid_address 218 96; restart_syscall 219 128
fadvise64 221 223; clock_gettime 228 113; clock_getres 229 114; clock_nanosleep 230 115
exit_group 231 94; epoll_wait 232 -; epoll_ctl 233 21; openat 257 56; mkdirat 258 34
newfstatat 262 79; unlinkat 263 35; renameat 264 38; readlinkat 267 78; faccessat 269 48
pselect6 270 72; ppoll 271 73; set_robust_list 273 99; epoll_pwait 281 22;
eventfd2 290 19; epoll_create1 291 20; dup3 292 24; pipe2 293 59; preadv 295 69; pwritev 296 70
getcpu 309 168; renameat2 316 276; getrandom 318 278; membarrier 324 283; statx 332 291
rseq 334 293; close_range 436 436; faccessat2 439 439
"""
# Allowed with some arguments only, and what a worker needs to seal itself.
_CHECKED = """
ioctl 16 29; socketpair 53 199; clone 56 220; fcntl 72 25; prctl 157 167; prlimit64 302 261
landlock_create_ruleset 444 444; landlock_add_rule 445 445; landlock_restrict_self 446 446
"""
# What probes try, or a test allows.
_REFUSED = """
socket 41 198; connect 42 203; shmget 29 194; fork 57 -; vfork 58 -; execve 59 221; wait4 61 260
kill 62 129; truncate 76 45; chmod 90 -; fchmodat 268 53; ptrace 101 117; setpriority 141 140
mount 165 40; tkill 200 130; utimensat 280 88; rt_sigqueueinfo 129 138; tgkill 234 131
keyctl 250 219
unshare 272 97; linkat 265 37; symlinkat 266 36; link 86 -; perf_event_open 298 241; setns 308 268
process_vm_readv 310 270; process_vm_writev 311 271; memfd_create 319 279; bpf 321 280
execveat 322 281; userfaultfd 323 282; pidfd_send_signal 424 424; io_uring_setup 425 425
pidfd_open 434 434; clone3 435 435; pidfd_getfd 438 438; sendmsg 46 211
"""


def _numbers(table: str) -> dict[str, tuple[int | None, ...]]:
    entries = (entry.split() for entry in table.replace("\n", ";").split(";") if entry.strip())
    return {
        name: tuple(None if number == "-" else int(number) for number in numbers)
        for name, *numbers in entries
    }


ALLOWED = frozenset(_numbers(_ALLOWED))
_NUMBERS = _numbers(f"{_ALLOWED};{_CHECKED};{_REFUSED}")


def number_of(name: str, machine: str) -> int | None:
    """Returns the number of a system call; None if a machine has it not.

    >>> number_of("read", "x86_64"), number_of("open", "aarch64")
    (0, None)
    """
    return _NUMBERS[name][MACHINES.index(machine)]
