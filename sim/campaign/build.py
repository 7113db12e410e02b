"""Builds the programs of the jobs and copies them to FOLDER/bin: dynrt, all tests and benches, and built.json, which lists them.

    build.py FOLDER [--no-cargo]

A file is replaced only if its content differs, so results of an unchanged program remain valid. --no-cargo copies the existing
target/release/dynrt, without tests and benches.
"""

import filecmp
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from jobs import ROOT


def cargo(*words):
    """Returns the executables that cargo has built or found up to date."""
    command = ["cargo", *words, "--quiet", "--message-format=json"]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    messages = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode != 0:
        for message in messages:
            sys.stderr.write((message.get("message") or {}).get("rendered") or "" if message["reason"] == "compiler-message" else "")
        sys.exit(f"{' '.join(command)}: ended with status {done.returncode}")
    return [message for message in messages if message["reason"] == "compiler-artifact" and message.get("executable")]


def place(source, target):
    if not (target.exists() and filecmp.cmp(source, target, shallow=False)):
        # Rename instead of overwriting, because the program may be running.
        part = target.with_name(f".{target.name}.part")
        shutil.copy2(source, part)
        os.utime(part)
        part.replace(target)


def name_of(message):
    """Returns the name of a test target: the test's own name, or the name of a library or program with its kind."""
    target = message["target"]
    kind = target["kind"][0]
    return target["name"] if kind in ("test", "bench") else f"{target['name']}.{kind}"


def listed(program):
    """Returns the tests of a program, except ignored ones."""
    def names(*words):
        command = [program, "--list", "--format", "terse", *words]
        text = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        return [line.removesuffix(": test") for line in text.splitlines() if line.endswith(": test")]

    ignored = set(names("--ignored"))
    return [name for name in names() if name not in ignored]


def main():
    folder = Path(sys.argv[1]).absolute() / "bin"
    folder.mkdir(parents=True, exist_ok=True)
    built = {"tests": {}, "benches": {}}
    if "--no-cargo" not in sys.argv[2:]:
        cargo("build", "--release")
        for what, words in (("tests", ["test", "--workspace", "--no-run"]), ("benches", ["bench", "--no-run"])):
            for message in cargo(*words):
                if not message["profile"]["test"] and message["target"]["kind"] != ["bench"]:
                    continue
                name = name_of(message)
                program = f"{what}-{name}"
                if program in built[what]:
                    sys.exit(f"{name}: two programs have this name")
                place(Path(message["executable"]), folder / program)
                # The directory in which cargo would run it.
                package = Path(message["manifest_path"]).parent
                built[what][program] = {"name": name, "package": os.path.relpath(package, ROOT)}
                if what == "tests":
                    built[what][program]["tests"] = listed(folder / program)
        built["tests"] = {program: about for program, about in built["tests"].items() if about["tests"]}
    place(ROOT / "target/release/dynrt", folder / "dynrt")
    (folder / "built.json").write_text(json.dumps(built, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
