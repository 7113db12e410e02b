#!/usr/bin/env python3
# SPDX-License-Identifier: MIT OR Apache-2.0
"""Compares a register file in SystemRDL with what its C header says.

    sim/check_rdl.py FILE.rdl < FACTS

FACTS is the output of a C program that includes the header, a line each:
    register NAME OFFSET ACCESS RESET     ACCESS is RO, RW, W1C or WO
    field REGISTER NAME SHIFT MASK
    error NAME CODE
A register without fields has one of 32 bits in SystemRDL. Needs the Python package systemrdl-compiler. The last line begins with PASS or
FAIL; the exit status is 0 only after PASS.
"""

import sys

from systemrdl import RDLCompiler, RDLCompileError
from systemrdl.rdltypes import AccessType, OnWriteType

# What software does with a field, by its properties sw and onwrite.
ACCESS = {
    (AccessType.r, None): "RO",
    (AccessType.rw, None): "RW",
    (AccessType.rw, OnWriteType.woclr): "W1C",
    (AccessType.w, None): "WO",
}

WHOLE = {"VALUE": (0, 0xFFFFFFFF)}


def read_facts(lines):
    """Registers with their fields, and error codes, as the header has them."""
    registers, errors = {}, {}
    for line in lines:
        kind, *words = line.split()
        if kind == "register":
            name, offset, access, reset = words
            registers[name] = {"offset": int(offset), "access": access, "reset": int(reset), "fields": {}}
        elif kind == "field":
            register, name, shift, mask = words
            registers[register]["fields"][name] = (int(shift), int(mask))
        elif kind == "error":
            errors[words[0]] = int(words[1])
        else:
            raise ValueError(line)
    for register in registers.values():
        register["fields"] = register["fields"] or WHOLE
    return registers, errors


def read_rdl(path):
    """The same as SystemRDL has them."""
    compiler = RDLCompiler()
    compiler.compile_file(path)
    registers, errors = {}, {}
    for register in compiler.elaborate().top.registers():
        fields, access, reset = {}, set(), 0
        for field in register.fields():
            mask = ((1 << field.width) - 1) << field.low
            fields[field.inst_name.upper()] = (field.low, mask)
            properties = field.get_property("sw"), field.get_property("onwrite")
            access.add(ACCESS.get(properties, str(properties)))
            reset |= field.get_property("reset") << field.low
            for member in field.get_property("encode") or ():
                errors[member.name.upper()] = member.value
        registers[register.inst_name] = {
            "offset": register.absolute_address,
            "access": "/".join(sorted(access)),
            "reset": reset,
            "fields": fields,
        }
    return registers, errors


def main() -> int:
    if len(sys.argv) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    registers, errors = read_facts(sys.stdin)
    try:
        found, codes = read_rdl(sys.argv[1])
    except RDLCompileError as error:
        print(f"FAIL {sys.argv[1]}: {error}")
        return 1
    if not registers or not errors:
        print("FAIL there are no facts to compare")
        return 1
    faults = 0
    for name in sorted(registers.keys() | found.keys()):
        if registers.get(name) != found.get(name):
            print(f"{name}: the header has {registers.get(name)}, SystemRDL {found.get(name)}")
            faults += 1
    if errors != codes:
        print(f"errors: the header has {errors}, SystemRDL {codes}")
        faults += 1
    fields = sum(len(register["fields"]) for register in registers.values())
    verdict = "PASS" if faults == 0 else f"FAIL {faults} differences in"
    print(f"{verdict} {len(registers)} registers, {fields} fields, {len(errors)} error codes")
    return 0 if faults == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
