"""Bounds on time that hold on a machine that is slow or busy."""

# A process, a thread or a file that is not done after so many seconds hangs.
HANGS = 300.0
