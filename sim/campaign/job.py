"""Runs one job of a campaign, and writes its JSON if and only if the job succeeds.

    job.py --part PART --job NAME --out F.json --log F.log --minutes N --threads N --kind KIND --package DIR [--full] \
        --bin DIR -- COMMAND ...

A failed job writes F.failed with the last lines of its output, and F.fault.json if the command described the fault. An interrupted job
leaves only its log. KIND says how the command's output is interpreted, see jobs.py.
"""

import argparse
import hashlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from jobs import BIN, JSON, ROOT, scenes


def sha256(path):
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def program_of(command, programs):
    """Returns the identity of a program: the hash of its content if it is in the campaign's bin/, otherwise its name."""
    path = command[0].replace(BIN, str(programs))
    return sha256(path) if path != command[0] else path


def read_tests(text, asked):
    """Reads the output of Rust's test harness. Every named test must have passed; without names, at least one."""
    summaries = re.findall(r"^test result: (\w+)\. (\d+) passed; (\d+) failed", text, re.M)
    passed = sum(int(passed) for _, passed, _ in summaries)
    if any(outcome != "ok" or failed != "0" for outcome, _, failed in summaries) or passed != (len(asked) or passed) or not passed:
        raise ValueError(f"{passed} of {len(asked) or 'all'} tests passed")
    # A test that lacks a scene or a tool prints a note and passes.
    lacking = re.findall(r"^.*(?:absent, so not checked|not installed).*$", text, re.M)
    return {"passed": passed, "lacking": sorted({line.strip() for line in lacking})}


def stop(process):
    """Ends the command and all processes that it has started."""
    try:
        os.killpg(process.pid, signal.SIGTERM)
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            pass
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass


def main():
    parser = argparse.ArgumentParser()
    for option in ("part", "job", "kind", "package"):
        parser.add_argument(f"--{option}", required=True)
    for option in ("out", "log", "bin"):
        parser.add_argument(f"--{option}", required=True, type=lambda path: Path(path).absolute())
    parser.add_argument("--minutes", required=True, type=float)
    parser.add_argument("--threads", required=True, type=int)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("command", nargs="+")
    args = parser.parse_args()

    args.out.parent.mkdir(parents=True, exist_ok=True)
    failed, fault = args.out.with_suffix(".failed"), args.out.with_suffix(".fault.json")
    written = args.out.with_name(f"{args.job}.part.json")
    for of_before in (failed, fault, written):
        of_before.unlink(missing_ok=True)
    words = [word.replace(BIN, str(args.bin)).replace(JSON, str(written)) for word in args.command]

    environment = dict(os.environ)
    environment.setdefault("DYNRT_SCENES", str(scenes()))
    environment["RAYON_NUM_THREADS"] = environment["RUST_TEST_THREADS"] = str(args.threads)
    # Snapshots are compared and never written; they are found without cargo.
    environment.update(INSTA_UPDATE="no", INSTA_WORKSPACE_ROOT=str(ROOT))
    environment.pop("DYNRT_FULL", None)
    if args.full:
        environment["DYNRT_FULL"] = "1"

    def tell(result, why=None):
        return {
            "part": args.part,
            "job": args.job,
            "command": args.command,
            "program": program_of(args.command, args.bin),
            "host": socket.gethostname(),
            "threads": args.threads,
            "seconds": round(time.monotonic() - started, 1),
            **({"why": why} if why else {}),
            "result": result,
        }

    def fail(why):
        text = args.log.read_text(encoding="utf-8", errors="replace")
        lines = [line for line in text.splitlines() if line.strip()]
        said = {"last": lines[-20:]}
        # A program that has found a fault may have described it in a file.
        if written.exists():
            written.replace(fault)
        failed.write_text(json.dumps(tell(said, why), indent=1) + "\n", encoding="utf-8")
        sys.exit(f"{args.part}/{args.job}: {why}; see {args.log}")

    started = time.monotonic()
    with open(args.log, "w", encoding="utf-8") as log:
        print("$", *words, file=log, flush=True)
        process = subprocess.Popen(
            words, cwd=ROOT / args.package, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
        )

        def cut_off(number, _frame):
            stop(process)
            written.unlink(missing_ok=True)
            sys.exit(128 + number)

        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, cut_off)
        parent, status, is_over = os.getppid(), None, False
        while status is None:
            try:
                status = process.wait(1)
            except subprocess.TimeoutExpired:
                if os.getppid() != parent:
                    # The process that runs the campaign was killed, so end the job as well; nobody would read its result.
                    cut_off(signal.SIGHUP, None)
                if time.monotonic() - started > args.minutes * 60:
                    is_over = True
                    stop(process)
                    status = process.wait()
    if is_over:
        fail(f"did not end within {args.minutes:g} minutes")
    if status != 0:
        fail(f"ended with status {status}" if status > 0 else f"ended by signal {-status}")
    try:
        if args.kind == "json":
            result = json.loads(written.read_text(encoding="utf-8"))
        else:
            text = args.log.read_text(encoding="utf-8", errors="replace")
            if args.kind == "text":
                result = {"text": text.splitlines()[1:]}
            else:
                result = read_tests(text, words[3:] if args.kind == "tests" else [])
    except (OSError, ValueError) as error:
        fail(f"left no result: {error}")
    # Rename, so the file is never incomplete.
    written.write_text(json.dumps(tell(result), indent=1) + "\n", encoding="utf-8")
    written.replace(args.out)


if __name__ == "__main__":
    main()
