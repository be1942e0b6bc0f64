"""Bounds on time that hold on a machine that is slow or busy."""

# A process, a thread or a file that was not done after so many seconds never will be.
HANGS = 300.0
