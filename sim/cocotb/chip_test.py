# SPDX-License-Identifier: MIT OR Apache-2.0
"""The chip between the AXI models of cocotbext-axi: it casts the rays of a packed scene, and the bytes of the hits are the golden chip's.

run.py calls it, and names the folder of `dynrt pack` in DYNRT_PACK and the header of the registers in DYNRT_HEADER.
"""

import json
import os
import random
import re
from pathlib import Path

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, FallingEdge, RisingEdge, with_timeout
from cocotbext.axi import AxiBus, AxiLiteBus, AxiLiteMaster, AxiRam

PACK = Path(os.environ["DYNRT_PACK"])
MANIFEST = json.loads((PACK / "manifest.json").read_text())

# The macros of the header that are numbers, without DYNRT_.
MACRO = re.compile(r"^#define DYNRT_(\w+) (\w+?)u\b", re.MULTILINE)
REGS = {name: int(value, 0) for name, value in MACRO.findall(Path(os.environ["DYNRT_HEADER"]).read_text())}

PERIOD_NS = 10
# The most cycles of a list.
PATIENCE = 200_000


def pauses(percent: int):
    """Whether to pause, cycle by cycle."""
    while True:
        yield random.randrange(100) < percent


class Host:
    """A memory behind the master, and a master in front of the registers."""

    def __init__(self, dut):
        self.dut = dut
        end = MANIFEST["load_address"] + MANIFEST["bytes"]
        size = 1 << (end - 1).bit_length()
        self.memory = AxiRam(AxiBus.from_prefix(dut, "m_axi"), dut.clk, dut.rst, size=size)
        self.registers = AxiLiteMaster(AxiLiteBus.from_prefix(dut, "s_axi"), dut.clk, dut.rst)

    def pause(self, percent: int):
        """Pauses every channel at random."""
        write, read = self.memory.write_if, self.memory.read_if
        for channel in (write.aw_channel, write.w_channel, write.b_channel, read.ar_channel, read.r_channel):
            channel.set_pause_generator(pauses(percent))

    async def start(self):
        self.dut.rst.value = 1
        cocotb.start_soon(Clock(self.dut.clk, PERIOD_NS, unit="ns").start())
        await ClockCycles(self.dut.clk, 4)
        self.dut.rst.value = 0
        await ClockCycles(self.dut.clk, 2)

    async def read(self, name: str) -> int:
        return await self.registers.read_dword(REGS["REG_" + name])

    async def write(self, name: str, value: int):
        await self.registers.write_dword(REGS["REG_" + name], value)


async def check_constants(host: Host):
    """The constants are those of the header, and the rest is idle."""
    for name in ("ID", "VERSION", "FORMAT", "PACKETS", "TREE", "BUS", "CACHES", "CACHE_KIB"):
        assert await host.read(name) == REGS[name + "_RESET"], name
    for name in ("LIST", "STATUS", "ERROR_CODE", "INTERRUPT_STATUS", "INTERRUPT_ENABLE"):
        assert await host.read(name) == 0, name


async def cast(host: Host):
    """Runs the list of the image, and compares every byte of memory."""
    dut, frame = host.dut, MANIFEST["frames"][0]
    image = (PACK / "image.bin").read_bytes()
    expected = (PACK / frame["result"]).read_bytes()
    first, count = frame["result_address"] - MANIFEST["load_address"], frame["result_bytes"]
    assert len(expected) == count > 0
    after = image[:first] + expected + image[first + count :]
    assert after != image, "a list that changes nothing shows nothing"
    host.memory.write(MANIFEST["load_address"], image)

    end = REGS["INTERRUPT_STATUS_END_MASK"]
    await host.write("INTERRUPT_ENABLE", end | REGS["INTERRUPT_STATUS_ERROR_MASK"])
    await host.write("LIST", frame["command_list"])
    assert dut.irq.value == 0
    await host.write("DOORBELL", 1)
    await with_timeout(RisingEdge(dut.irq), PATIENCE * PERIOD_NS, "ns")
    assert await host.read("ERROR_CODE") == REGS["ERROR_NONE"]
    assert await host.read("INTERRUPT_STATUS") == end
    assert await host.read("STATUS") == 0
    await host.write("INTERRUPT_STATUS", end)
    if dut.irq.value != 0:
        await with_timeout(FallingEdge(dut.irq), 10 * PERIOD_NS, "ns")

    found = host.memory.read(MANIFEST["load_address"], len(image))
    for place, (byte, right) in enumerate(zip(found, after)):
        assert byte == right, f"byte {place:#x} of the image is {byte:#04x} and not {right:#04x}"
    await host.write("SNAPSHOT", 1)
    rays = await host.read("CAST_RAYS_LOW")
    # The last packet is filled up, and inactive rays are rays as well.
    assert rays >= MANIFEST["rays"] > 0
    cycles = await host.read("LIST_CYCLES_LOW")
    dut._log.info(f"{rays} rays, {cycles} cycles, {len(image)} bytes of memory compared, {count} of them hits")


@cocotb.test()
async def memory_without_pauses(dut):
    host = Host(dut)
    await host.start()
    await check_constants(host)
    await cast(host)


@cocotb.test()
async def memory_with_pauses(dut):
    host = Host(dut)
    host.pause(40)
    await host.start()
    await cast(host)
