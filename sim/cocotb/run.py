#!/usr/bin/env python3
# SPDX-License-Identifier: MIT OR Apache-2.0
"""Runs chip_test.py on the Verilog of a chip in Icarus Verilog.

    sim/cocotb/run.py RTL PACK [FOLDER]

RTL is a folder that `dynrt generate --top chip` wrote, PACK one that `dynrt pack` wrote for the same configuration. FOLDER takes the files
of the simulation, by default build/cocotb. Needs the Python packages cocotb (2) and cocotbext-axi (0.1.28 or later), and iverilog.
The last line begins with PASS or FAIL; the exit status is 0 only after PASS.
"""

import json
import sys
from pathlib import Path

from cocotb_tools.runner import get_results, get_runner

# Tests of chip_test.py.
TESTS = 2


def main() -> int:
    if len(sys.argv) not in (3, 4):
        print(__doc__, file=sys.stderr)
        return 2
    rtl, pack = (Path(word).resolve() for word in sys.argv[1:3])
    folder = Path(sys.argv[3] if len(sys.argv) == 4 else "build/cocotb").resolve()
    for file in (rtl / "manifest.json", pack / "manifest.json"):
        if not file.is_file():
            print(f"FAIL {file} is missing")
            return 1
    manifest = json.loads((rtl / "manifest.json").read_text())
    if "host" not in manifest:
        print(f"FAIL {rtl} holds no chip: generate it with --top chip")
        return 1
    top = manifest["top"]
    header = rtl / manifest["host"]["header"]
    packed = json.loads((pack / "manifest.json").read_text())
    if header.read_text() != (pack / "dynrt_regs.h").read_text():
        print(f"FAIL {rtl} and {pack} are of different machines: {manifest['configuration']['name']}, {packed['config']}")
        return 1
    runner = get_runner("icarus")
    runner.build(
        sources=[rtl / file for file in manifest["files"]],
        hdl_toplevel=top,
        build_args=["-g2001"],
        build_dir=folder,
        timescale=("1ns", "1ps"),
        always=True,
    )
    results = runner.test(
        test_module="chip_test",
        hdl_toplevel=top,
        build_dir=folder,
        seed=1,
        test_dir=Path(__file__).resolve().parent,
        results_xml=str(folder / "results.xml"),
        extra_env={"DYNRT_PACK": str(pack), "DYNRT_HEADER": str(header), "PYTHONDONTWRITEBYTECODE": "1"},
    )
    tests, failures = get_results(results)
    if tests != TESTS or failures != 0:
        print(f"FAIL {failures} of {tests} tests failed, and there are {TESTS}")
        return 1
    size = (pack / packed["frames"][0]["result"]).stat().st_size
    print(f"PASS {tests} tests, {packed['rays']} rays and {size} bytes of hits each")
    return 0


if __name__ == "__main__":
    sys.exit(main())
