"""Defines the jobs of a campaign from its configuration. The Snakefile runs them; report.py reads their results.

A job is one command with a time limit. It is defined by the configuration and, for tests and benches, by the list that build.py
writes.
"""

import json
import re
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import yaml

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
DEFAULT = HERE / "config.yaml"

# Placeholders in a command: the JSON file to write, and the folder of the programs.
JSON = "@JSON@"
BIN = "@BIN@"

# The parts in the order of the report.
PARTS = "proofs faults machines mutants areas routed depths frames embree tests speed figures".split()


@dataclass
class Job:
    part: str
    name: str
    command: list
    minutes: int = 30
    threads: int = 2
    # The interpretation of the output: "json" (the command writes JSON), "tests" and "examples" (Rust's test harness), "text".
    kind: str = "json"
    # The programs below bin/ that the job runs, and the jobs that must be done before, as PART/NAME.
    programs: list = field(default_factory=lambda: ["dynrt"])
    after: list = field(default_factory=list)
    full: bool = False
    # Its working directory, relative to the source tree.
    package: str = "."

    @property
    def path(self):
        return f"{self.part}/{self.name}"


class Mistake(Exception):
    """An error in the configuration."""


def read_config(path):
    with open(path, encoding="utf-8") as file:
        return yaml.safe_load(file)


def folder_of(config):
    return ROOT / config.get("folder", "target/campaign")


class Plan:
    """All jobs of a configuration by part, and the parts that are left out, with the reasons."""

    def __init__(self, config):
        known = {*PARTS, "folder"}
        unknown = sorted(set(config) - known)
        if unknown:
            raise Mistake(f"{', '.join(unknown)}: no part of a campaign; these are: {', '.join(PARTS)}")
        self.folder = folder_of(config)
        self.left_out = []
        self.config = config
        self.parts = {}
        for part in PARTS:
            if part in config:
                self.parts[part] = {}
                for job in getattr(self, part)(config[part]):
                    self.add(job)
        for job in self.all():
            job.after = [path for path in job.after if self.find(path)]

    def add(self, job):
        if not re.fullmatch(r"[\w.+-]+", job.name):
            raise Mistake(f"{job.path}: no name of a file")
        if job.name in self.parts[job.part]:
            raise Mistake(f"{job.path}: is there twice")
        self.parts[job.part][job.name] = job

    def all(self):
        return [job for jobs in self.parts.values() for job in jobs.values()]

    def find(self, path):
        part, name = path.split("/")
        return self.parts.get(part, {}).get(name)

    # Each of these methods creates the jobs of one part.

    def proofs(self, given, plant=()):
        part = "faults" if plant else "proofs"
        for unit in given["units"]:
            command = dynrt("prove", *plant, unit, *given.get("options", []), "--json", JSON)
            yield Job(part, unit, command)

    def faults(self, given):
        return self.proofs(given, ["--plant"])

    def machines(self, given):
        each = given["each"]
        for number in range(given["jobs"]):
            seed = given["seed"] + number * each
            command = dynrt("fuzz", "--machines", each, "--seed", seed, "--json", JSON)
            yield Job("machines", f"seed{seed}-{seed + each - 1}", command)

    def mutants(self, given):
        for seed in given["seeds"]:
            for unit in given["units"]:
                command = dynrt("mutate", "--mutants", given["mutants"], "--seed", seed, "--unit", unit)
                # The report compares the sum over all jobs with the required percentage.
                command += ["--least", "0", "--json", JSON]
                yield Job("mutants", f"{unit}-seed{seed}", command)

    def areas(self, given):
        for configuration, units in given["units"].items():
            for unit in units:
                names = unit.split()
                units_of = [word for name in names for word in ("--unit", name)]
                command = dynrt("synth", "--config", configuration, *units_of, "--json", JSON)
                yield Job("areas", f"{configuration}-{names[0]}", command, threads=1)

    def routed(self, given):
        for configuration in given["configurations"]:
            for unit in given["units"]:
                before = []
                for seed in range(1, given["seeds"] + 1):
                    command = dynrt("synth", "--config", configuration, "--unit", unit, "--route")
                    command += ["--seeds", str(seed), "--json", JSON]
                    name = f"{configuration}-{unit}-seed{seed}"
                    # Each job routes with one new seed; the results of earlier seeds come from the cache.
                    yield Job("routed", name, command, minutes=90, threads=1, after=before)
                    before = [f"routed/{name}"]

    def depths(self, given):
        for unit in given["units"]:
            for clock in given["clocks"]:
                command = dynrt("synth", "--unit", unit, "--clocks", clock, "--route", "--json", JSON)
                yield Job("depths", f"{unit}-{clock}", command, threads=1)

    def frames(self, given):
        for frame in given:
            scene, stem = self.scene(frame["scene"], "frames")
            if not scene:
                continue
            words = [stem, frame.get("view"), frame["size"], frame.get("rays"), frame.get("config")]
            command = dynrt("cosim", scene, "--size", frame["size"])
            for key in ("view", "rays", "config"):
                if key in frame:
                    command += [f"--{key}", frame[key]]
            yield Job("frames", "-".join(filter(None, words)), command + ["--json", JSON], threads=1)

    def embree(self, given):
        for frame in given["scenes"]:
            scene, stem = self.scene(frame["scene"], "embree")
            if not scene:
                continue
            command = dynrt("compare", scene, "--view", frame["view"], "--size", given["size"], "--json", JSON)
            # This job measures times.
            yield Job("embree", f"{stem}-{frame['view']}", command, threads=given["threads"])

    def tests(self, given):
        built = self.built("tests")
        each, seen = given.get("each", []), set()
        for program, about in built.items():
            groups = {}
            for test in about["tests"]:
                module = test.split("::")[0] if "::" in test else ""
                key = f"{about['name']} {module}".strip()
                seen.add(key)
                # All tests that are in no module are one job.
                alone = key in each
                groups.setdefault((module, test if alone else None), []).append(test)
            for (module, alone), tests in groups.items():
                words = [about["name"], *(alone or module).split("::")]
                command = [f"{BIN}/{program}", "--exact", "--show-output", *tests]
                name = "-".join(filter(None, words))
                programs = ["dynrt", program]
                yield Job("tests", name, command, kind="tests", programs=programs, full=given["full"], package=about["package"])

        unknown = [key for key in each if key not in seen]
        if built and unknown:
            raise Mistake(f"tests: {', '.join(unknown)}: no module of a test program")
        if given.get("examples") and built:
            # The examples in the documentation, which only cargo can build.
            command = ["cargo", "test", "--workspace", "--doc"]
            yield Job("tests", "examples", command, kind="examples", full=given["full"])

    def speed(self, given):
        for program, about in self.built("benches").items():
            command = [f"{BIN}/{program}", "--bench"]
            threads = given["threads"]
            yield Job("speed", about["name"], command, kind="text", threads=threads, programs=[program], package=about["package"])

    def figures(self, given):
        yield Job(
            "figures",
            "baseline",
            dynrt("baseline", *given["options"], "--json", JSON),
            # All of its measurements except frames and films are then in the cache.
            after=[job.path for part in ("areas", "routed", "depths") for job in self.parts.get(part, {}).values()],
        )

    def scene(self, name, part):
        """Returns the name of a scene on a command line and in a file name, or None if the scene is missing."""
        if name.startswith("builtin:"):
            return name, re.sub(r"[^\w.]+", "_", name.removeprefix("builtin:"))
        path = scenes() / name
        if path.exists():
            return str(path), path.name
        self.left_out.append(f"{part}: {name} is not there (sim/fetch_scenes.sh)")
        return None, None

    def built(self, what):
        try:
            return json.loads((self.folder / "bin" / "built.json").read_text(encoding="utf-8"))[what]
        except FileNotFoundError:
            return {}


def dynrt(*words):
    return [f"{BIN}/dynrt", *map(str, words)]


def scenes():
    where = subprocess.run([ROOT / "sim/fetch_scenes.sh", "--where"], capture_output=True, text=True, check=True)
    return Path(where.stdout.strip()).resolve()
