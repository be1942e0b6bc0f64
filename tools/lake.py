"""Checks that a lake gives what each of its episodes gives by itself.

`python -m tools.lake record FOLDER COUNT` records episodes of 20 bodies, 2 s each.
`python -m tools.lake check FOLDER [--engines local,ray,spark]` asks five questions of a loop of
`ssduck.open`, and of each engine: the last tick, the first touch, the longest rest, the least
clearance, and a reward with its success.
`python -m tools.lake flip COUNT [--seed N]` flips a bit of a record of short episodes COUNT times,
before or after its manifest is made; each answer must be the right one, or an error of its episode.
`python -m tools.lake standalone FOLDER` starts a master of Spark with two workers on this machine,
asks a question, kills one of the workers midway, and compares the answers.

The exit status is 1 if there are faults.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from pathlib import Path
from typing import Any

import ssduck
from ssduck.errors import ProgramWarning
from ssduck.lakes.lake import Lake
from ssduck.lakes.workers import forget_readers
from tests.support.lake_episodes import REWARD, SUCCESS, record_episodes
from tests.support.lake_questions import PROGRAMS, answer_of, scores

# The short episodes whose bytes are flipped.
EPISODES, STEPS = 4, 6
REPORT_EVERY = 50
MASTER = "spark://127.0.0.1:7177"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    record = commands.add_parser("record")
    record.add_argument("folder", type=Path)
    record.add_argument("count", type=int)
    check = commands.add_parser("check")
    check.add_argument("folder", type=Path)
    check.add_argument("--engines", default="local,ray,spark")
    flip = commands.add_parser("flip")
    flip.add_argument("count", type=int)
    flip.add_argument("--seed", type=int, default=0)
    standalone = commands.add_parser("standalone")
    standalone.add_argument("folder", type=Path)
    options = parser.parse_args()
    warnings.simplefilter("ignore", ProgramWarning)
    if options.command == "record":
        record_episodes(options.folder, options.count)
        return 0
    if options.command == "check":
        return check_engines(options.folder, options.engines.split(","))
    if options.command == "standalone":
        return check_standalone(options.folder)
    return check_flips(options.count, options.seed)


# -- engines ----------------------------------------------------------------------------------


def by_themselves(folder: Path, count: int) -> dict[str, list[tuple[str | None, str | None]]]:
    """Returns the answers of a loop of `open`, and their errors, by question."""
    answers: dict[str, list[tuple[str | None, str | None]]] = {name: [] for name in PROGRAMS}
    for number in range(count):
        with ssduck.open(folder, "sim", number) as ss:
            for name, program in PROGRAMS.items():
                answers[name].append(answer_of(ss, program))
    return answers


def texts_of(lake: Lake, program: str, engine: Any, **arguments: Any) -> list[Any]:
    """Returns the answers of a lake as texts, with their errors."""
    rows = lake.ask(program, engine=engine, **arguments)
    values = rows["answer"].to_pylist()
    if str(rows["answer"].type) != "string":
        values = [None if value is None else json.dumps(value) for value in values]
    return list(zip(values, rows["error"].to_pylist(), strict=True))


def check_engines(folder: Path, engines: list[str]) -> int:
    started = time.perf_counter()
    lake = Lake(folder)
    print(f"{lake}: manifest in {time.perf_counter() - started:.0f} s", flush=True)
    wanted = by_themselves(folder, len(lake))
    print(f"loop of open: {time.perf_counter() - started:.0f} s", flush=True)
    wanted_scores = scores(folder)
    faults = 0
    for engine in engines:
        for name, program in PROGRAMS.items():
            answers = texts_of(lake, program, engine)
            wrong = sum(one != other for one, other in zip(answers, wanted[name], strict=True))
            print(f"{engine}, {name}: {len(answers)} answers, {wrong} differ", flush=True)
            faults += wrong
        rows = lake.score(SUCCESS, reward=REWARD, engine=engine)  # type: ignore[arg-type]
        pairs = zip(rows["return"].to_pylist(), rows["success"].to_pylist(), strict=True)
        wrong = sum(one != other for one, other in zip(pairs, wanted_scores, strict=True))
        print(f"{engine}, a reward: {rows.num_rows} answers, {wrong} differ", flush=True)
        faults += wrong
    print(f"{faults} faults, {time.perf_counter() - started:.0f} s")
    return int(faults > 0)


def check_standalone(folder: Path) -> int:
    """Asks a master of Spark with two workers, one of which is killed."""
    import pyspark
    from pyspark.sql import SparkSession

    program = PROGRAMS["least clearance"]
    lake = Lake(folder)
    wanted = texts_of(lake, program, "local")
    home = Path(pyspark.__file__).parent
    paths = os.pathsep.join([str(Path.cwd()), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"SPARK_HOME": str(home), "PYTHONPATH": paths}
    os.environ.update(environment, PYSPARK_PYTHON=sys.executable)
    script = str(home / "bin" / "spark-class")
    deploy = "org.apache.spark.deploy"
    address = ["--host", "127.0.0.1"]
    ports = ["--port", "7177", "--webui-port", "0"]

    def start(*arguments: str) -> subprocess.Popen[bytes]:
        command = [script, *arguments, *address]
        return subprocess.Popen(  # noqa: S603
            command, env=environment, stderr=subprocess.DEVNULL, start_new_session=True
        )

    servers = [start(f"{deploy}.master.Master", *ports)]
    try:
        time.sleep(15)
        with tempfile.TemporaryDirectory() as place:
            work = ["--cores", "1", "--memory", "1g", "--work-dir", place, MASTER]
            servers += [start(f"{deploy}.worker.Worker", *work) for _ in range(2)]
            time.sleep(15)
            builder = SparkSession.builder.master(MASTER).config("spark.ui.enabled", "false")
            settings = {"spark.driver.host": "127.0.0.1", "spark.executor.memory": "512m"}
            for name, value in settings.items():
                builder = builder.config(name, value)
            session = builder.getOrCreate()
            texts_of(lake, "1;", "spark", session=session, batch=len(lake))
            killer = threading.Timer(3.0, os.killpg, (servers[1].pid, signal.SIGKILL))
            killer.start()
            answers = texts_of(lake, program, "spark", session=session, batch=2)
            is_killed = not killer.is_alive()
            session.stop()
    finally:
        for server in servers:
            if server.poll() is None:
                os.killpg(server.pid, signal.SIGKILL)
    wrong = sum(one != other for one, other in zip(answers, wanted, strict=True))
    print(f"{len(answers)} answers, {wrong} differ; a worker was killed midway: {is_killed}")
    return int(wrong > 0 or not is_killed)


# -- flipped bits -----------------------------------------------------------------------------


def check_flips(count: int, seed: int) -> int:
    choices = random.Random(seed)  # noqa: S311  # no secret
    faults = errors = 0
    with tempfile.TemporaryDirectory() as place:
        whole, copy = Path(place, "whole"), Path(place, "copy")
        record_episodes(whole, EPISODES, steps=STEPS)
        Lake(whole)
        program = "[on(sim.table, sim.cup), holds(z(sim.cup) > 0.4), least(clearance(sim.gripper, "
        program += (
            "sim.wall)), SELECT this FROM sim WHERE contactForce(this, sim.table) > 0 AS list];"
        )
        wanted = texts_of(Lake(whole), program, "local", processes=1)
        for number in range(1, count + 1):
            forget_readers()  # a model that was read before the damage is no test
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(whole, copy)
            if choices.random() < 0.5:
                next(copy.glob("*manifest.parquet")).unlink()
            files = sorted(file for file in copy.rglob("*") if file.is_file())
            file = choices.choice(files)
            content = bytearray(file.read_bytes())
            position = choices.randrange(len(content))
            content[position] ^= 1 << choices.randrange(8)
            status = file.stat()
            file.write_bytes(content)
            if choices.random() < 0.5:  # as a disk does it
                os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))
            try:
                answers = texts_of(Lake(copy), program, "local", processes=1)
            except ssduck.SelectScriptError as error:
                print(f"fault: {file.relative_to(copy)}, byte {position}: {error}")
                faults += 1
                continue
            pairs = zip(answers, wanted, strict=True) if len(answers) == len(wanted) else ()
            is_right = [one == other or one[1] is not None for one, other in pairs]
            errors += any(error is not None for _, error in answers)
            if not is_right or not all(is_right):
                print(f"fault: {file.relative_to(copy)}, byte {position}: {answers}")
                faults += 1
            if number % REPORT_EVERY == 0 or number == count:
                print(f"{number} flipped: {errors} with errors, {faults} faults", flush=True)
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
