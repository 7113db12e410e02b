"""Reports the results of a campaign: one table, and report.json and report.md in its folder.

    report.py [--folder] [CONFIG.yaml]

A job is done if its JSON exists and belongs to the configured command and to the program in the campaign's bin/. It has failed if it
wrote a .failed file, and is missing otherwise. The exit status is 0 only if all jobs are done, every part has jobs, every figure counts
something, and the sums reach the configured limits. With --folder the script only prints the campaign's folder.
"""

import json
import sys

import jobs
from job import program_of


def number(value):
    return f"{value:,}"


class Fault(Exception):
    """A part that fails although its jobs are done."""


def need(count, what):
    if not count:
        raise Fault(f"no {what}")
    return count


def proofs(results, _given):
    rows = [row for result in results for row in result["proofs"]]
    holding = sum(row["holds"] for row in rows)
    need(len(rows), "proofs")
    figures = {"proofs": len(rows), "hold": holding}
    if holding < len(rows):
        raise Fault(f"{len(rows) - holding} of {len(rows)} proofs do not hold")
    return figures, f"{number(holding)} proofs hold"


def faults(results, _given):
    rows = [row for result in results for row in result["proofs"]]
    refuted = sum(row["holds"] for row in rows)
    need(len(rows), "seeded faults")
    if refuted < len(rows):
        raise Fault(f"{len(rows) - refuted} of {len(rows)} seeded faults are not refuted")
    return {"faults": len(rows), "refuted": refuted}, f"{number(refuted)} seeded faults refuted"


def machines(results, _given):
    passed = need(sum(result["passed"] for result in results), "machines")
    compared = need(sum(sum(result["checked"].values()) for result in results), "results")
    return {"machines": passed, "results": compared}, f"{number(passed)} machines, {number(compared)} results compared"


def mutants(results, given):
    drawn, noticed, equivalent, survived = (
        sum(result[key] for result in results) for key in ("drawn", "noticed", "equivalent", "survived")
    )
    # The same definition as in `dynrt mutate`. If all mutants are equivalent, there is no percentage.
    percent = 100 * noticed / need(drawn - equivalent, "mutants that are not equivalent")
    figures = {
        "mutants": drawn,
        "noticed": noticed,
        "equivalent": equivalent,
        "survived": survived,
        "noticed_percent": round(percent, 2),
        "survivors": [
            {"seed": result["seed"], **mutant}
            for result in results
            for mutant in result["mutants"]
            if mutant["outcome"] == "survived"
        ],
    }
    text = f"{number(drawn)} mutants: {number(noticed)} killed ({percent:.1f} %), {equivalent} equivalent, {survived} survived"
    if percent < given["least"]:
        raise Fault(f"{text}; the configuration requires at least {given['least']} %", figures)
    return figures, text


def areas(results, _given):
    units = [
        {"configuration": result["configuration"]["name"], "unit": unit["name"], **unit["area"]}
        for result in results
        for unit in result["units"]
    ]
    return {"modules": units}, f"{number(need(len(units), 'modules'))} modules"


def routed(results, _given):
    clocks = {}
    for result in results:
        for unit in result["units"]:
            seeds = clocks.setdefault((result["configuration"]["name"], unit["name"]), {})
            seeds.update(enumerate(unit["mhz_by_seed"], 1))
    need(len(clocks), "clocks")
    units = [
        {"configuration": configuration, "unit": unit, "mhz": min(seeds.values()), "mhz_by_seed": list(seeds.values())}
        for (configuration, unit), seeds in clocks.items()
    ]
    slowest = {}
    for unit in units:
        known = slowest.get(unit["configuration"])
        slowest[unit["configuration"]] = min(known, unit, key=lambda unit: unit["mhz"]) if known else unit
    text = ", ".join(f"{unit['mhz']:.1f} MHz {name} ({unit['unit']})" for name, unit in slowest.items())
    return {"units": units}, f"{len(units)} units; the slowest, worst of its seeds: {text}"


def depths(results, _given):
    points = [
        {"unit": unit["name"], "asked_mhz": clock["clock_mhz"], "depth": unit["latency"], "mhz": unit["mhz"]}
        for result in results
        for clock in result["clocks"]
        for unit in clock["report"]["units"]
    ]
    return {"points": points}, f"{need(len(points), 'pipelines')} pipelines routed"


def frames(results, _given):
    keys = ("scene", "view", "ray_kind", "width", "height", "config", "rays", "cycles", "checked", "rays_per_clock")
    wrong = sum(result["mismatches"] for result in results)
    if wrong:
        raise Fault(f"{wrong} mismatches")
    cycles = need(sum(result["cycles"] for result in results), "cycles")
    compared = need(sum(result["checked"] for result in results), "results")
    table = [{key: result[key] for key in keys} for result in results]
    return {"frames": table, "cycles": cycles}, f"{len(table)} frames, {number(cycles)} cycles, {number(compared)} results compared"


def embree(results, _given):
    rays = need(sum(result["rays"] for result in results), "rays")
    agreements = [result[when] for result in results for when in ("built", "refitted")]
    different = sum(agreement["different"] for agreement in agreements)
    if not all(result["agrees"] for result in results):
        raise Fault("hits differ")
    figures = {"rays": rays, "different": different}
    return figures, f"{len(results)} scenes, {number(2 * rays)} rays, {number(different)} hit another triangle, all explained"


def tests(results, _given):
    passed = need(sum(result["passed"] for result in results), "tests")
    lacking = sorted({line for result in results for line in result["lacking"]})
    said = f"; missing scenes and tools: {len(lacking)}" if lacking else ""
    return {"passed": passed, "lacking": lacking}, f"{number(passed)} tests passed{said}"


def speed(results, _given):
    return {"benches": len(results)}, f"{need(len(results), 'benches')} benches; their figures are in their logs"


def figures(results, _given):
    checked = need(sum(result["checked"] for result in results), "figures")
    failed = sum(result["failed"] for result in results)
    if failed:
        raise Fault(f"{failed} of {checked} figures are worse than docs/baseline.json")
    return {"checked": checked}, f"{number(checked)} figures compared with docs/baseline.json"


def state_of(job, folder, programs):
    """Returns `done` with the job's result, `failed` with the reason, or `missing` with the reason."""
    path = folder / f"{job.path}.json"
    program = job.command[0]
    if program not in programs:
        try:
            programs[program] = program_of(job.command, folder / "bin")
        except OSError:
            programs[program] = None

    def is_this(left):
        return left["command"] == job.command and left["program"] == programs[program]

    def read(path):
        try:
            return json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None

    failed = read(path.with_suffix(".failed"))
    if failed and is_this(failed):
        return "failed", failed
    left = read(path)
    if left and is_this(left):
        return "done", left
    other = failed or left
    return "missing", {"why": "the result belongs to another program or another command"} if other else None


def report(plan):
    parts, programs = {}, {}
    for part, of_part in plan.parts.items():
        states = {"done": {}, "failed": {}, "missing": {}}
        for name, job in of_part.items():
            state, about = state_of(job, plan.folder, programs)
            before = [path for path in job.after if state_of(plan.find(path), plan.folder, programs)[0] != "done"]
            if state == "missing" and before and not about:
                about = {"why": f"waits for {before[0]}, which is not done"}
            states[state][name] = about
        done = states["done"].values()
        entry = {
            "jobs": len(of_part),
            **{state: len(jobs) for state, jobs in states.items()},
            "job_seconds": round(sum(about["seconds"] for about in done), 1),
            "longest_seconds": max((about["seconds"] for about in done), default=0),
            "fault": None if of_part else "a part without jobs",
            "headline": "",
            "figures": {},
            "failed_jobs": {name: {"why": about["why"], **about["result"]} for name, about in states["failed"].items()},
            "missing_jobs": {name: about and about["why"] for name, about in states["missing"].items()},
        }
        if done:
            try:
                entry["figures"], entry["headline"] = globals()[part]([about["result"] for about in done], plan.config[part])
            except Fault as fault:
                entry["fault"] = fault.args[0]
                entry["figures"] = fault.args[1] if len(fault.args) > 1 else {}
        parts[part] = entry
    return {
        "complete": bool(parts) and all(part["done"] == part["jobs"] and not part["fault"] for part in parts.values()),
        "left_out": plan.left_out,
        "parts": parts,
    }


COLUMNS = ["part", "jobs", "done", "failed", "missing", "minutes", "longest", "what"]


def rows_of(found):
    for name, part in found["parts"].items():
        what = f"FAULT: {part['fault']}" if part["fault"] else part["headline"]
        minutes = [f"{part[key] / 60:.1f}" for key in ("job_seconds", "longest_seconds")]
        yield [name, *(str(part[key]) for key in COLUMNS[1:5]), *minutes, what]


def notes_of(found):
    """Yields one line with the reason for each job that is not done, and for each part that was left out."""
    for name, part in found["parts"].items():
        for job, about in part["failed_jobs"].items():
            last = about["last"][-1].strip() if about["last"] else ""
            yield f"FAILED {name}/{job}: {about['why']}: {last}"
    for name, part in found["parts"].items():
        for job, why in part["missing_jobs"].items():
            yield f"MISSING {name}/{job}" + (f": {why}" if why else "")
    for line in found["left_out"]:
        yield f"LEFT OUT {line}"


def to_text(found, most=20):
    rows = [COLUMNS, *rows_of(found)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(COLUMNS))]
    lines = []
    for row in rows:
        cells = [cell.ljust(width) if column in (0, 7) else cell.rjust(width) for column, (cell, width) in enumerate(zip(row, widths))]
        lines.append("  ".join(cells).rstrip())
    notes = list(notes_of(found))
    lines += notes[:most]
    if len(notes) > most:
        lines.append(f"... and {len(notes) - most} more, all in report.md")
    lines.append(ending(found))
    return "\n".join(lines) + "\n"


def ending(found):
    parts = found["parts"].values()
    total = {key: sum(part[key] for part in parts) for key in COLUMNS[1:5]}
    faults = [name for name, part in found["parts"].items() if part["fault"]]
    text = f"{total['done']} of {total['jobs']} jobs done, {total['failed']} failed, {total['missing']} missing"
    return text + (f"; failed checks: {', '.join(faults)}" if faults else "")


def to_markdown(found):
    def table(rows):
        cells = [" | ".join(cell.replace("|", "\\|") for cell in row) for row in rows]
        return "".join(f"| {row} |\n" for row in cells)

    notes = "".join(f"- {line}\n" for line in notes_of(found))
    return (
        f"# Campaign\n\n{ending(found)}.\n\n"
        + table([COLUMNS, ["---"] * len(COLUMNS), *rows_of(found)])
        + (f"\n## Not done\n\n{notes}" if notes else "")
    )


def main():
    words = [word for word in sys.argv[1:] if word != "--folder"]
    config = jobs.read_config(words[0] if words else jobs.DEFAULT)
    if "--folder" in sys.argv:
        print(jobs.folder_of(config))
        return
    plan = jobs.Plan(config)
    found = report(plan)
    plan.folder.mkdir(parents=True, exist_ok=True)
    (plan.folder / "report.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    (plan.folder / "report.md").write_text(to_markdown(found), encoding="utf-8")
    print(to_text(found), end="")
    print(f"report: {plan.folder / 'report.md'}")
    sys.exit(0 if found["complete"] else 1)


if __name__ == "__main__":
    try:
        main()
    except (jobs.Mistake, OSError) as error:
        sys.exit(f"error: {error}")
