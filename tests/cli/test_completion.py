"""The completion of the command line itself, in the shell of the operating system."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

BASH = shutil.which("bash")


@pytest.mark.slow
@pytest.mark.skipif(BASH is None, reason="needs bash")
def test_bash_completes_commands_after_the_installation(tmp_path):
    environment = os.environ | {"HOME": str(tmp_path)}
    environment["PATH"] = f"{Path(sys.executable).parent}:{environment['PATH']}"

    def bash(script):
        return subprocess.run(
            [str(BASH), "-c", script], env=environment, capture_output=True, text=True, check=True
        ).stdout

    bash("ssduck --install-completion; exit $?")  # it asks which shell has called it
    # What bash does when Tab is pressed behind `ssduck vi`.
    script = (
        f"source {next((tmp_path / '.bash_completions').iterdir())}; COMP_WORDS=(ssduck vi); "
        'COMP_CWORD=1; _ssduck_completion ssduck; echo "${COMPREPLY[@]}"'
    )
    assert bash(script).split() == ["view"]
