#!/usr/bin/env python3
"""Checks a folder that `dynrt vectors` wrote by recomputing its contents.

    sim/check_vectors.py DIR [--limit N] [--jobs N] [--json FILE] [--quiet]

The script was written only from docs/vectors.md, docs/arithmetic.md, docs/layout.md, docs/update.md and a folder's manifest.json; it
shares no code with the program that writes the folder. It reads from the folder only the contents that the pages do not determine (a
camera, a mesh's vertices, random operands) and predicts everything else in all bits: expected values, care masks, the steps, tests and
ray transformations of each packet and their order, the structure of the trees, the writes of updates and skinning, the figures of the
manifest, and the macros.

Numbers are Python floats (IEEE doubles). For two numbers of at most 24 significant bits, the product is exact in a double. Sum and
quotient are precise enough that a second rounding gives the same result as one rounding of the exact value. The vectors of the
arithmetic units are also recomputed with integers.

Exit status: 0 if something was checked and no mismatch was found; 1 if something is wrong or missing, with one line that describes it;
2 for a usage error. Requires Python 3.9 or later and only its standard library.
"""

import argparse
import collections
import hashlib
import json
import math
import multiprocessing
import os
import re
import sys

VERSION = 3
ALL_ONES = 0xFFFFFFFF
INF = math.inf
NAN = math.nan
AXES = "xyz"
WORLD = (-INF, INF)


class Refused(Exception):
    """A fault that prevents further checks, as one line."""


# ---- Report --------------------------------------------------------------------------------------------------------


class Report:
    """Counts checks and mismatches by kind, and keeps the first mismatch of each kind."""

    def __init__(self):
        self.kinds = {}

    def _row(self, kind):
        row = self.kinds.get(kind)
        if row is None:
            row = self.kinds[kind] = [0, 0, None]
        return row

    def count(self, kind, values=1):
        self._row(kind)[0] += values

    def wrong(self, kind, file, line, field, expected, found, number=None):
        """Records a mismatch; `line` counts from 1 (None for a whole file), `number` converts bits to a number."""
        row = self._row(kind)
        row[1] += 1
        if row[2] is None:
            row[2] = {
                "file": file,
                "line": line,
                "field": field,
                "expected": shown(expected, number),
                "found": shown(found, number),
            }

    def expect(self, kind, file, line, field, expected, found):
        """Checks one value."""
        self.count(kind)
        if expected != found or isinstance(expected, bool) != isinstance(found, bool):
            self.wrong(kind, file, line, field, expected, found)
            return False
        return True

    def claim(self, kind, file, line, field, holds, expected, found):
        """Checks a property other than equality; `expected` describes it."""
        self.count(kind)
        if not holds:
            self.wrong(kind, file, line, field, expected, found)
        return holds

    def add(self, other):
        for kind, (checked, mismatches, first) in other.items():
            row = self._row(kind)
            row[0] += checked
            row[1] += mismatches
            row[2] = row[2] or first


def shown(value, number):
    """Formats a value for the report: bits in hexadecimal, and their meaning."""
    if isinstance(value, bool) or not isinstance(value, int) or number is None:
        return value if isinstance(value, (str, int)) else repr(value)
    return "0x%x (%s)" % (value, number(value))


# ---- Numbers -------------------------------------------------------------------------------------------------------


class Numbers:
    """The section *Numbers* of arithmetic.md, with floats that represent values of the format."""

    def __init__(self, exponent_bits, fraction_bits):
        self.exponent_bits, self.fraction_bits = exponent_bits, fraction_bits
        self.width = 1 + exponent_bits + fraction_bits
        self.bias = (1 << exponent_bits - 1) - 1
        self.sign = 1 << self.width - 1
        self.fraction_mask = (1 << fraction_bits) - 1
        self.exponent_mask = (1 << exponent_bits) - 1
        self.inf = self.exponent_mask << fraction_bits
        self.nan = self.inf | 1 << fraction_bits - 1
        self.greatest = self.inf - 1
        self.least = 1 << fraction_bits
        self._decoded, self._encoded = {}, {}
        self.round, self.down, self.up = self._functions()

    def decode(self, bits):
        """The value of a pattern; −0 stays −0."""
        value = self._decoded.get(bits)
        if value is None:
            exponent = bits >> self.fraction_bits & self.exponent_mask
            fraction = bits & self.fraction_mask
            if exponent == 0:
                value = 0.0
            elif exponent == self.exponent_mask:
                value = NAN if fraction else INF
            else:
                value = math.ldexp(fraction + (1 << self.fraction_bits), exponent - self.bias - self.fraction_bits)
            if bits & self.sign:
                value = -value
            self._decoded[bits] = value
        return value

    def encode(self, value):
        """The pattern of a result, which is never −0."""
        bits = self._encoded.get(value)
        if bits is None:
            if value != value:
                return self.nan
            if value == 0:
                return 0
            size = abs(value)
            if size == INF:
                bits = self.inf
            else:
                mantissa, exponent = math.frexp(size)
                fraction = int(math.ldexp(mantissa, self.fraction_bits + 1)) - (1 << self.fraction_bits)
                bits = (exponent - 1 + self.bias) << self.fraction_bits | fraction
            if value < 0:
                bits |= self.sign
            self._encoded[value] = bits
        return bits

    def text(self, bits):
        return "%.9g" % self.decode(bits)

    def canonical(self, bits, minus_zero=False):
        """Whether a pattern is the canonical one of its value."""
        exponent = bits >> self.fraction_bits & self.exponent_mask
        if exponent == self.exponent_mask:
            return bits & self.fraction_mask == 0 or bits == self.nan
        return exponent != 0 or bits == 0 or minus_zero and bits == self.sign

    def _functions(self):
        """Creates the functions for rounding and for steps of three ulps, with the format's constants."""
        frexp, ldexp = math.frexp, math.ldexp
        precision = self.fraction_bits + 1
        # Adding this to a mantissa in [1/2, 1) rounds away the bits below 2^-precision, ties to even.
        chop = 1.5 * 2.0 ** (52 - precision)
        least, limit = ldexp(1.0, 1 - self.bias), ldexp(1.0, self.bias + 1)
        three = 3.0 * 2.0**-precision
        low, high = 0.5 + three, 1.0 - three

        def rounded(x):
            """Rounds an exact result, or one close enough to round the same, to the format."""
            mantissa, exponent = frexp(x)
            try:
                y = ldexp((mantissa + chop) - chop, exponent)
            except OverflowError:
                y = INF if x > 0 else -INF
            if least <= y < limit or -limit < y <= -least:
                return y
            if y != y:
                return y
            return INF if y >= limit else -INF if y <= -limit else 0.0

        def stepped(x, steps):
            if x != x or x in (INF, -INF):
                return x
            bits = self.encode(x)
            # Ranks of the values: 0 for both zeros, then the least normal number.
            place = max(0, (bits & ~self.sign) - self.least + 1)
            place = (-place if bits & self.sign else place) + steps
            if place == 0:
                return 0.0
            size = min(abs(place) + self.least - 1, self.inf)
            return self.decode(size | (self.sign if place < 0 else 0))

        # Between two powers of two, three ulps can be subtracted directly.
        def down(x):
            mantissa, exponent = frexp(x)
            if low <= mantissa or -high < mantissa <= -0.5:
                if exponent or -INF < x < INF:
                    return x - ldexp(three, exponent)
            return stepped(x, -3)

        def up(x):
            mantissa, exponent = frexp(x)
            if 0.5 <= mantissa < high or mantissa <= -low:
                if exponent or -INF < x < INF:
                    return x + ldexp(three, exponent)
            return stepped(x, 3)

        return rounded, down, up

    def reciprocal(self, x):
        if x == 0:
            return math.copysign(INF, x)
        if x in (INF, -INF):
            return 0.0
        return self.round(1.0 / x)

    # The arithmetic units a second time, on bits, with integers only.

    def _parts(self, bits):
        """Sign, kind and, for a number, the significand and the exponent of its last bit."""
        exponent = bits >> self.fraction_bits & self.exponent_mask
        fraction = bits & self.fraction_mask
        negative = bits & self.sign != 0
        if exponent == 0:
            return negative, "zero", 0, 0
        if exponent == self.exponent_mask:
            return negative, "nan" if fraction else "infinity", 0, 0
        return negative, "number", fraction | 1 << self.fraction_bits, exponent - self.bias - self.fraction_bits

    def _pack(self, negative, significand, exponent, sticky=False):
        """±significand × 2^exponent, slightly larger in magnitude if `sticky`, rounded once."""
        if significand == 0:
            return 0
        surplus = significand.bit_length() - self.fraction_bits - 1
        if surplus > 0:
            rest = significand & (1 << surplus) - 1
            significand >>= surplus
            half = 1 << surplus - 1
            if rest > half or rest == half and (sticky or significand & 1):
                significand += 1
        else:
            significand <<= -surplus
        exponent += surplus
        if significand >> self.fraction_bits + 1:
            significand >>= 1
            exponent += 1
        stored = exponent + self.fraction_bits + self.bias
        if stored < 1:
            return 0
        sign = self.sign if negative else 0
        if stored >= self.exponent_mask:
            return sign | self.inf
        return sign | stored << self.fraction_bits | significand & self.fraction_mask

    def add_bits(self, a, b, flip=0):
        a_negative, a_kind, a_significand, a_exponent = self._parts(a)
        b_negative, b_kind, b_significand, b_exponent = self._parts(b ^ flip)
        if "nan" in (a_kind, b_kind):
            return self.nan
        if a_kind == "infinity":
            return self.nan if b_kind == "infinity" and a_negative != b_negative else (a & self.sign) | self.inf
        if b_kind == "infinity":
            return (b ^ flip) & self.sign | self.inf
        exponent = min(a_exponent, b_exponent)
        total = (-1 if a_negative else 1) * (a_significand << a_exponent - exponent)
        total += (-1 if b_negative else 1) * (b_significand << b_exponent - exponent)
        return self._pack(total < 0, abs(total), exponent)

    def sub_bits(self, a, b):
        return self.add_bits(a, b, self.sign)

    def mul_bits(self, a, b):
        a_negative, a_kind, a_significand, a_exponent = self._parts(a)
        b_negative, b_kind, b_significand, b_exponent = self._parts(b)
        kinds = (a_kind, b_kind)
        if "nan" in kinds or kinds in (("infinity", "zero"), ("zero", "infinity")):
            return self.nan
        if "infinity" in kinds:
            return (self.sign if a_negative != b_negative else 0) | self.inf
        return self._pack(a_negative != b_negative, a_significand * b_significand, a_exponent + b_exponent)

    def reciprocal_bits(self, a):
        negative, kind, significand, exponent = self._parts(a)
        if kind == "nan":
            return self.nan
        if kind == "infinity":
            return 0
        if kind == "zero":
            return (self.sign if negative else 0) | self.inf
        scale = 2 * self.fraction_bits + 8
        quotient, rest = divmod(1 << scale, significand)
        return self._pack(negative, quotient, -scale - exponent, rest != 0)


# ---- Layouts -------------------------------------------------------------------------------------------------------


class Layout:
    """Named bit fields of a line, from the least significant bit up."""

    def __init__(self, name, fields):
        """`fields` is a list of (name, width, kind), without gaps."""
        self.name, self.fields, self.at = name, [], {}
        lsb = 0
        for field, width, kind in fields:
            self.fields.append((field, lsb, width, kind))
            self.at[field] = (lsb, (1 << width) - 1)
            lsb += width
        self.width = lsb
        self.digits = (lsb + 3) // 4

    def get(self, line, field):
        lsb, mask = self.at[field]
        return line >> lsb & mask

    def vector(self, line, field):
        return tuple(self.get(line, "%s_%s" % (field, axis)) for axis in AXES)

    def pack(self, **values):
        line = 0
        for field, value in values.items():
            line |= value << self.at[field][0]
        return line

    def put_vector(self, field, bits):
        line = 0
        for axis, value in zip(AXES, bits):
            line |= value << self.at["%s_%s" % (field, axis)][0]
        return line

    def mask(self, *fields):
        """A mask of all bits of some fields."""
        return sum(self.at[field][1] << self.at[field][0] for field in fields)


def layouts_of(width, rays, tag_bits, watertight, two_levels):
    """All layouts of vectors.md and layout.md for a machine, by name."""

    def numbers(*names):
        return [(name, width, "number") for name in names]

    def vectors(*names):
        return numbers(*("%s_%s" % (name, axis) for name in names for axis in AXES))

    def unsigned(bits, *names):
        return [(name, bits, "unsigned") for name in names]

    def flags(*names):
        return [(name, 1, "flag") for name in names]

    def mask(bits, *names):
        return [(name, bits, "mask") for name in names]

    link = unsigned(26, "link") + flags("left_leaf", "right_leaf") + unsigned(2, "left_axis", "right_axis")
    bounds = numbers("left_lo", "left_hi", "right_lo", "right_hi")
    ray = vectors("origin", "direction") + numbers("tmin", "tmax") + flags("active", "any_hit")
    test_kind = unsigned(2, "kz") + vectors("shear") if watertight else vectors("direction")
    of_rays = []
    for k in range(rays):
        prefix = "ray%d_" % k
        of_rays += vectors(prefix + "origin", prefix + "reciprocal")
        of_rays += mask(3, prefix + "signs") + numbers(prefix + "near", prefix + "far")
    children = ["%s_ray%d_%s" % (side, k, end) for side in ("left", "right") for k in range(rays) for end in ("near", "far")]
    influences = []
    for k in range(4):
        influences += [("weight%d" % k, width - 1, "number"), ("joint%d" % k, 8, "unsigned"), ("last%d" % k, 1, "flag")]
    vertex = numbers("x", "y", "z")
    table = {
        "nodes": bounds + link,
        "records": unsigned(32, "v0", "v1", "v2", "number"),
        "vertices": vertex,
        "scene": unsigned(32, "root") + vectors("lo", "hi"),
        "raycast_rays": ray + unsigned(tag_bits, "tag"),
        "raycast_hits": numbers("t", "u", "v") + unsigned(32, "instance", "triangle") + unsigned(tag_bits, "tag"),
        "raycast_packets": unsigned(tag_bits, "tag")
        + unsigned(32, "first_step", "steps", "first_test", "tests", "first_transform", "transforms", "scene", "block"),
        "update_program": unsigned(64, "low", "high"),
        "update_vertices": vertex,
        "update_nodes_before": bounds + link,
        "update_records": unsigned(32, "v0", "v1", "v2", "number"),
        "update_commands": unsigned(26, "program", "rows", "vertex_base", "node_base", "box_index")
        + unsigned(32, "first_write", "writes", "instructions"),
        "update_node_writes": unsigned(26, "node") + mask(5, "mask") + bounds,
        "update_nodes_after": bounds + link,
        "update_boxes": vectors("lo", "hi"),
        "skinning_influences": influences,
        "skinning_vectors": vertex,
        "skinning_commands": unsigned(26, "palette")
        + unsigned(9, "joints")
        + unsigned(26, "influences", "rows", "rest", "vertices", "target")
        + unsigned(32, "first_vertex", "count"),
        "skinning_expected": unsigned(26, "vertex") + vertex,
        "ray_setup_stimulus": ray,
        "ray_setup_expected": flags("enters")
        + numbers("near", "far", "tmin", "tmax")
        + flags("any_hit")
        + vectors("origin", "reciprocal")
        + mask(3, "signs")
        + test_kind,
        "packet_step_stimulus": unsigned(26, "node") + bounds + link + mask(rays, "mask") + of_rays,
        "packet_step_expected": mask(rays, "to_left", "to_right", "both_left_first")
        + flags("left_first", "goes_on", "next_leaf")
        + unsigned(26, "next")
        + flags("pushes", "pushed_leaf")
        + unsigned(26, "pushed")
        + numbers(*children),
        "triangle_test_stimulus": unsigned(3, "slot")
        + unsigned(26, "record")
        + vectors("v0", "v1", "v2")
        + numbers("tmin", "tmax", "window_near", "window_far")
        + vectors("origin", "reciprocal")
        + mask(3, "signs")
        + test_kind,
        "triangle_test_expected": flags("hit") + numbers("t", "u", "v"),
    }
    if two_levels:
        table["ray_transform_stimulus"] = (
            unsigned(3, "slot")
            + unsigned(26, "record")
            + vectors("cx", "cy", "cz", "cw", "lo", "hi", "origin", "direction", "reciprocal")
            + mask(3, "signs")
        )
        table["ray_transform_expected"] = vectors("origin", "direction") + numbers("near", "far")
    for unit in ("fp_add", "fp_sub", "fp_mul", "fp_reciprocal"):
        table[unit + "_stimulus"] = numbers("a") if unit == "fp_reciprocal" else numbers("a", "b")
        table[unit + "_expected"] = numbers("y")
    return {name: Layout(name, fields) for name, fields in table.items()}


# ---- The machine's units -------------------------------------------------------------------------------------------


class Ray:
    """A ray in the world or in object space: origin, direction, and the results of ray setup."""

    __slots__ = (
        "o", "d", "r", "signs", "kz", "shear", "o_bits", "d_bits", "r_bits",
        "valid", "tmin", "tmax", "any_hit", "near", "far", "window",
    )  # fmt: skip


Node = collections.namedtuple("Node", "line left right link left_leaf right_leaf left_axis right_axis")
Step = collections.namedtuple("Step", "to_left to_right both_left_first left_first goes_on next pushed left right")


class Units:
    """The results of each unit, as arithmetic.md defines them."""

    def __init__(self, numbers, rays, watertight, layouts):
        self.numbers, self.rays, self.watertight, self.layouts = numbers, rays, watertight, layouts
        self._prepare_packing()

    # -- Ray setup and clipping

    def set_up(self, origin, direction):
        """Steps 3 and 4 of *Ray setup*, from bits."""
        numbers = self.numbers
        ray = Ray()
        ray.o_bits, ray.d_bits = origin, direction
        ray.o = tuple(map(numbers.decode, origin))
        ray.d = d = tuple(map(numbers.decode, direction))
        ray.signs = sum((bits & numbers.sign != 0) << i for i, bits in enumerate(direction))
        ray.r = r = tuple(map(numbers.reciprocal, d))
        ray.r_bits = tuple(map(numbers.encode, r))
        kz = 0
        for i in (1, 2):
            if abs(d[i]) > abs(d[kz]):
                kz = i
        ray.kz = kz
        ray.shear = (
            numbers.round(d[(kz + 1) % 3] * r[kz]),
            numbers.round(d[(kz + 2) % 3] * r[kz]),
            r[kz],
        )
        ray.window = WORLD
        return ray

    def world_ray(self, origin, direction, tmin, tmax, active, any_hit, box):
        """All steps of *Ray setup*."""
        ray = self.set_up(origin, direction)
        decode = self.numbers.decode
        # A zero becomes +0, because the sum of a zero and +0 is +0.
        ray.tmin, ray.tmax, ray.any_hit = decode(tmin) + 0.0, decode(tmax) + 0.0, any_hit
        no_nan = all(x == x for x in ray.o + ray.d + (ray.tmin, ray.tmax))
        ray.valid = bool(active and no_nan and 0 <= ray.tmin <= ray.tmax)
        ray.near, ray.far = self.clip_box(ray.tmin, ray.tmax, box, ray)
        return ray

    def clip_box(self, near, far, box, ray):
        lo, hi = box
        for i in range(3):
            near, far = self.clip(near, far, lo[i], hi[i], ray.o[i], ray.r[i], ray.signs >> i & 1)
        return near, far

    def clip(self, near, far, lo, hi, o, r, s):
        numbers = self.numbers
        rounded = numbers.round
        if s:
            lo, hi = hi, lo
        x = numbers.down(rounded(rounded(lo - o) * r))
        y = numbers.up(rounded(rounded(hi - o) * r))
        return (x if x > near else near), (y if y < far else far)

    # -- The packet step

    def node_of(self, line):
        layout, decode = self.layouts["nodes"], self.numbers.decode
        get = layout.get
        left = decode(get(line, "left_lo")), decode(get(line, "left_hi"))
        right = decode(get(line, "right_lo")), decode(get(line, "right_hi"))
        rest = [get(line, name) for name in ("link", "left_leaf", "right_leaf", "left_axis", "right_axis")]
        return Node(line, left, right, *rest)

    def step(self, own, node, mask, rays, nears, fars):
        """One packet step; nears and fars are lists by slot."""
        clip = self.clip
        to_left = to_right = both_left_first = 0
        left, right = {}, {}
        for k in range(self.rays):
            if not mask >> k & 1:
                continue
            ray, near, far = rays[k], nears[k], fars[k]
            axis = node.left_axis
            l = clip(near, far, node.left[0], node.left[1], ray.o[axis], ray.r[axis], ray.signs >> axis & 1)
            axis = node.right_axis
            r = clip(near, far, node.right[0], node.right[1], ray.o[axis], ray.r[axis], ray.signs >> axis & 1)
            goes_left, goes_right = l[0] <= l[1], r[0] <= r[1]
            if goes_left:
                to_left |= 1 << k
                left[k] = l
            if goes_right:
                to_right |= 1 << k
                right[k] = r
            if goes_left and goes_right and l[0] <= r[0]:
                both_left_first |= 1 << k
        children = children_of(own, node)
        goes_on = bool(to_left or to_right)
        left_first = bool(both_left_first) if to_left and to_right else bool(to_left)
        following = children[0 if left_first else 1] if goes_on else None
        pushed = children[1 if left_first else 0] if to_left and to_right else None
        return Step(to_left, to_right, both_left_first, left_first, goes_on, following, pushed, left, right)

    # -- The triangle test

    def test(self, ray, vertices, tmin, tmax):
        """(t, u, v) of a hit, or None; `ray` includes its window, and the vertices are three tuples."""
        v0, v1, v2 = vertices
        lo, hi, flat = [], [], 0
        for i in range(3):
            a, b, c = v0[i], v1[i], v2[i]
            least = b if b < a else a
            least = c if c < least else least
            most = b if b > a else a
            most = c if c > most else most
            flat += least == most
            lo.append(least)
            hi.append(most)
        if flat >= 2 or equal(v0, v1) or equal(v1, v2) or equal(v0, v2):
            return None
        found = (self._watertight if self.watertight else self._moller_trumbore)(ray, v0, v1, v2)
        if found is None:
            return None
        t, u, v = found
        near, far = self.clip_box(ray.window[0], ray.window[1], (lo, hi), ray)
        if near > far or t != t:
            return None
        if t < near:
            t = near
        if t > far:
            t = far
        if tmin <= t <= tmax and t < INF:
            return t, u, v
        return None

    def _watertight(self, ray, v0, v1, v2):
        rounded = self.numbers.round
        o, kz = ray.o, ray.kz
        kx, ky = (kz + 1) % 3, (kz + 2) % 3
        ox, oy, oz = o[kx], o[ky], o[kz]
        sx, sy, sz = ray.shear
        moved = []
        for p in (v0, v1, v2):
            z = rounded(p[kz] - oz)
            x = rounded(rounded(p[kx] - ox) - rounded(sx * z))
            y = rounded(rounded(p[ky] - oy) - rounded(sy * z))
            moved.append((x, y, z))
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = moved
        u = rounded(rounded(cx * by) - rounded(cy * bx))
        v = rounded(rounded(ax * cy) - rounded(ay * cx))
        w = rounded(rounded(bx * ay) - rounded(by * ax))
        if (u < 0 or v < 0 or w < 0) and (u > 0 or v > 0 or w > 0):
            return None
        det = rounded(rounded(u + v) + w)
        if det == 0:
            return None
        i = self.numbers.reciprocal(det)
        distance = rounded(rounded(rounded(u * az) + rounded(v * bz)) + rounded(w * cz))
        return rounded(rounded(distance * i) * sz), rounded(v * i), rounded(w * i)

    def _moller_trumbore(self, ray, v0, v1, v2):
        rounded, d = self.numbers.round, ray.d

        def minus(a, b):
            return tuple(rounded(x - y) for x, y in zip(a, b))

        def cross(a, b):
            return tuple(
                rounded(rounded(a[j] * b[k]) - rounded(a[k] * b[j])) for j, k in ((1, 2), (2, 0), (0, 1))
            )

        def dot(a, b):
            return rounded(rounded(rounded(a[0] * b[0]) + rounded(a[1] * b[1])) + rounded(a[2] * b[2]))

        e1, e2, c = minus(v1, v0), minus(v2, v0), minus(ray.o, v0)
        p = cross(d, e2)
        det = dot(e1, p)
        i = self.numbers.reciprocal(det)
        q = cross(c, e1)
        u, v, t = rounded(dot(c, p) * i), rounded(dot(d, q) * i), rounded(dot(e2, q) * i)
        if u >= 0 and v >= 0 and rounded(u + v) <= 1 and det != 0:
            return t, u, v
        return None

    # -- Two levels

    def linear(self, columns, i, v):
        rounded = self.numbers.round
        x, y, z = (rounded(columns[k][i] * v[k]) for k in range(3))
        return rounded(rounded(x + y) + z)

    def transform(self, columns, box, ray):
        """Steps 1 to 3 of *Two levels*: the ray in object space, with its window."""
        rounded, encode = self.numbers.round, self.numbers.encode
        origin = [rounded(self.linear(columns, i, ray.o) + columns[3][i]) for i in range(3)]
        direction = [self.linear(columns, i, ray.d) for i in range(3)]
        moved = self.set_up(tuple(map(encode, origin)), tuple(map(encode, direction)))
        moved.window = self.clip_box(-INF, INF, box, ray)
        return moved

    # -- Skinning

    def skin(self, vertex, influences):
        """`influences` is a list of at most four (columns, weight)."""
        rounded = self.numbers.round
        result = []
        for i in range(3):
            q = [rounded(rounded(self.linear(p, i, vertex) + p[3][i]) * weight) for p, weight in influences]
            q += [0.0] * (4 - len(q))
            result.append(rounded(rounded(q[0] + q[1]) + rounded(q[2] + q[3])))
        return tuple(result)

    # -- Lines

    def _prepare_packing(self):
        """The positions of each ray's fields in the lines of packet steps."""
        stimulus, expected = self.layouts["packet_step_stimulus"], self.layouts["packet_step_expected"]
        self._ray_at, self._child_at = [], []
        for k in range(self.rays):
            names = ["ray%d_origin_x", "ray%d_reciprocal_x", "ray%d_signs", "ray%d_near", "ray%d_far"]
            self._ray_at.append([stimulus.at[name % k][0] for name in names])
            self._child_at.append([expected.at["%s_ray%d_near" % (side, k)][0] for side in ("left", "right")])

    def three(self, bits):
        """Three consecutive numbers."""
        width = self.numbers.width
        return bits[0] | bits[1] << width | bits[2] << 2 * width

    def step_stimulus(self, own, node, mask, rays, nears, fars):
        layout, encode = self.layouts["packet_step_stimulus"], self.numbers.encode
        at = layout.at
        line = own | node.line << at["left_lo"][0] | mask << at["mask"][0]
        for k in range(self.rays):
            ray, (origin, reciprocal, signs, near, far) = rays[k], self._ray_at[k]
            if mask >> k & 1:
                line |= self.three(ray.o_bits) << origin | self.three(ray.r_bits) << reciprocal | ray.signs << signs
                line |= encode(nears[k]) << near | encode(fars[k]) << far
            else:
                line |= self.numbers.inf << far
        return line

    def step_expected(self, step):
        """The expected line and its care mask."""
        layout, encode, width = self.layouts["packet_step_expected"], self.numbers.encode, self.numbers.width
        line = layout.pack(
            to_left=step.to_left,
            to_right=step.to_right,
            both_left_first=step.both_left_first,
            left_first=int(step.left_first),
            goes_on=int(step.goes_on),
            pushes=int(step.pushed is not None),
        )
        care = layout.mask("to_left", "to_right", "both_left_first", "left_first", "goes_on", "pushes")
        if step.goes_on:
            line |= layout.pack(next_leaf=int(step.next[1]), next=step.next[0])
            care |= layout.mask("next_leaf", "next")
        if step.pushed is not None:
            line |= layout.pack(pushed_leaf=int(step.pushed[1]), pushed=step.pushed[0])
            care |= layout.mask("pushed_leaf", "pushed")
        both = (1 << 2 * width) - 1
        for side, child in enumerate((step.left, step.right)):
            for k, (near, far) in child.items():
                lsb = self._child_at[k][side]
                line |= (encode(near) | encode(far) << width) << lsb
                care |= both << lsb
        return line, care

    def setup_expected(self, ray):
        layout, encode = self.layouts["ray_setup_expected"], self.numbers.encode
        enters = ray.valid and ray.near <= ray.far
        line = layout.pack(enters=int(enters), any_hit=ray.any_hit, signs=ray.signs)
        line |= layout.put_vector("origin", ray.o_bits) | layout.put_vector("reciprocal", ray.r_bits)
        every = [field for field, _, _, _ in layout.fields]
        uncared = {"near", "far", "tmin", "tmax", "kz", "shear_x", "shear_y", "shear_z"}
        if not self.watertight:
            line |= layout.put_vector("direction", ray.d_bits)
        if ray.valid:
            line |= layout.pack(tmin=encode(ray.tmin), tmax=encode(ray.tmax))
            uncared -= {"tmin", "tmax"}
            if self.watertight:
                line |= ray.kz << layout.at["kz"][0] | layout.put_vector("shear", map(encode, ray.shear))
                uncared -= {"kz", "shear_x", "shear_y", "shear_z"}
        if enters:
            line |= layout.pack(near=encode(ray.near), far=encode(ray.far))
            uncared -= {"near", "far"}
        return line, layout.mask(*(field for field in every if field not in uncared))

    def test_stimulus(self, slot, record, vertices, ray, tmin, tmax):
        """`vertices` is a list of nine numbers as bits; tmin and tmax are those of the ray in the world."""
        layout, encode = self.layouts["triangle_test_stimulus"], self.numbers.encode
        line = layout.pack(
            slot=slot,
            record=record,
            tmin=encode(tmin),
            tmax=encode(tmax),
            window_near=encode(ray.window[0]),
            window_far=encode(ray.window[1]),
            signs=ray.signs,
        )
        for name, vertex in zip(("v0", "v1", "v2"), vertices):
            line |= layout.put_vector(name, vertex)
        line |= layout.put_vector("origin", ray.o_bits) | layout.put_vector("reciprocal", ray.r_bits)
        if self.watertight:
            line |= ray.kz << layout.at["kz"][0] | layout.put_vector("shear", map(encode, ray.shear))
        else:
            line |= layout.put_vector("direction", ray.d_bits)
        return line

    def test_expected(self, hit):
        layout, encode = self.layouts["triangle_test_expected"], self.numbers.encode
        if hit is None:
            return 0, layout.mask("hit")
        t, u, v = map(encode, hit)
        return layout.pack(hit=1, t=t, u=u, v=v), layout.mask("hit", "t", "u", "v")

    def transform_stimulus(self, slot, record, vectors, ray):
        """`vectors` has the six vectors of the instance, as bits."""
        layout = self.layouts["ray_transform_stimulus"]
        line = layout.pack(slot=slot, record=record, signs=ray.signs)
        for name, vector in zip(("cx", "cy", "cz", "cw", "lo", "hi"), vectors):
            line |= layout.put_vector(name, vector)
        for name, vector in (("origin", ray.o_bits), ("direction", ray.d_bits), ("reciprocal", ray.r_bits)):
            line |= layout.put_vector(name, vector)
        return line

    def transform_expected(self, moved):
        layout, encode = self.layouts["ray_transform_expected"], self.numbers.encode
        line = layout.put_vector("origin", moved.o_bits) | layout.put_vector("direction", moved.d_bits)
        return line | layout.pack(near=encode(moved.window[0]), far=encode(moved.window[1]))

    # -- From a stimulus line to the expected line

    def of_setup(self, line, box):
        layout = self.layouts["ray_setup_stimulus"]
        get = layout.get
        ray = self.world_ray(
            layout.vector(line, "origin"),
            layout.vector(line, "direction"),
            get(line, "tmin"),
            get(line, "tmax"),
            get(line, "active"),
            get(line, "any_hit"),
            box,
        )
        return ray

    def of_step(self, line):
        layout, decode = self.layouts["packet_step_stimulus"], self.numbers.decode
        nodes = self.layouts["nodes"]
        node = self.node_of(line >> layout.at["left_lo"][0] & (1 << nodes.width) - 1)
        three, one = (1 << 3 * self.numbers.width) - 1, (1 << self.numbers.width) - 1
        rays, nears, fars = [], [], []
        for k in range(self.rays):
            origin, reciprocal, signs, near, far = self._ray_at[k]
            ray = Ray()
            ray.o = self._numbers(line >> origin & three)
            ray.r = self._numbers(line >> reciprocal & three)
            ray.signs = line >> signs & 7
            rays.append(ray)
            nears.append(decode(line >> near & one))
            fars.append(decode(line >> far & one))
        return self.step(layout.get(line, "node"), node, layout.get(line, "mask"), rays, nears, fars)

    def _numbers(self, bits):
        width, decode = self.numbers.width, self.numbers.decode
        one = (1 << width) - 1
        return decode(bits & one), decode(bits >> width & one), decode(bits >> 2 * width)

    def of_test(self, line):
        layout, decode = self.layouts["triangle_test_stimulus"], self.numbers.decode
        get = layout.get

        def vector(name):
            return tuple(map(decode, layout.vector(line, name)))

        ray = Ray()
        ray.o, ray.r, ray.signs = vector("origin"), vector("reciprocal"), get(line, "signs")
        ray.window = decode(get(line, "window_near")), decode(get(line, "window_far"))
        if self.watertight:
            ray.kz, ray.shear = get(line, "kz"), vector("shear")
        else:
            ray.d = vector("direction")
        corners = vector("v0"), vector("v1"), vector("v2")
        return self.test(ray, corners, decode(get(line, "tmin")), decode(get(line, "tmax")))

    def of_transform(self, line):
        layout, decode = self.layouts["ray_transform_stimulus"], self.numbers.decode

        def vector(name):
            return tuple(map(decode, layout.vector(line, name)))

        ray = Ray()
        ray.o, ray.d, ray.r = vector("origin"), vector("direction"), vector("reciprocal")
        ray.signs = layout.get(line, "signs")
        columns = [vector(name) for name in ("cx", "cy", "cz", "cw")]
        return self.transform(columns, (vector("lo"), vector("hi")), ray)


def equal(a, b):
    return a[0] == b[0] and a[1] == b[1] and a[2] == b[2]


def children_of(own, node):
    """The two children as (index, is a leaf): layout.md, *Where things lie*."""
    link = node.link
    if node.left_leaf:
        return (own, True), (link, bool(node.right_leaf))
    if node.right_leaf:
        return (link, False), (own, True)
    return (link, False), ((link + 1) % (1 << 26), False)


# ---- The folder ----------------------------------------------------------------------------------------------------

# File, unit, role, layout: the table *Files* of vectors.md.
FILES = [
    ("nodes.hex", "memory", "image", "nodes"),
    ("records.hex", "memory", "image", "records"),
    ("vertices.hex", "memory", "image", "vertices"),
    ("scene.hex", "memory", "registers", "scene"),
    ("raycast_rays.hex", "raycast", "stimulus", "raycast_rays"),
    ("raycast_hits.hex", "raycast", "expected", "raycast_hits"),
    ("raycast_packets.hex", "raycast", "packets", "raycast_packets"),
    ("update_program.hex", "update", "image", "update_program"),
    ("update_vertices.hex", "update", "image", "update_vertices"),
    ("update_nodes_before.hex", "update", "image", "update_nodes_before"),
    ("update_records.hex", "update", "image", "update_records"),
    ("update_commands.hex", "update", "stimulus", "update_commands"),
    ("update_node_writes.hex", "update", "expected", "update_node_writes"),
    ("update_nodes_after.hex", "update", "expected", "update_nodes_after"),
    ("update_boxes.hex", "update", "expected", "update_boxes"),
    ("skinning_influences.hex", "skinning", "image", "skinning_influences"),
    ("skinning_vectors.hex", "skinning", "image", "skinning_vectors"),
    ("skinning_commands.hex", "skinning", "stimulus", "skinning_commands"),
    ("skinning_expected.hex", "skinning", "expected", "skinning_expected"),
]
# The units with one expected line per stimulus line, and whether they have a care file.
UNITS = [
    ("ray_setup", True),
    ("packet_step", True),
    ("triangle_test", True),
    ("ray_transform", False),
    ("fp_add", False),
    ("fp_sub", False),
    ("fp_mul", False),
    ("fp_reciprocal", False),
]
# Units that are a library module with parameters.
LIBRARY = {"fp_add": ("fp_add_sub", {"SUBTRACT": 0}), "fp_sub": ("fp_add_sub", {"SUBTRACT": 1})}
PIPELINES = ["ray_setup", "tpu_slice", "triangle_test", "fp_add", "fp_sub", "fp_mul", "fp_reciprocal"]
# The prefix of all module names.
PREFIX = "dynrt_"
# The other units: module, stimulus, expected, other files, and read ports with their images.
WHOLE_UNITS = {
    "raycast": (
        "raycast_unit",
        "raycast_rays.hex",
        "raycast_hits.hex",
        ["raycast_packets.hex"],
        [("node", "nodes.hex"), ("record", "records.hex"), ("vertex", "vertices.hex")],
    ),
    "update": (
        "update_processor",
        "update_commands.hex",
        "update_node_writes.hex",
        [
            "update_program.hex",
            "update_vertices.hex",
            "update_nodes_before.hex",
            "update_records.hex",
            "update_nodes_after.hex",
            "update_boxes.hex",
        ],
        [("program", "update_program.hex"), ("vertex", "update_vertices.hex")],
    ),
    "skinning": (
        "raycast_unit",
        "skinning_commands.hex",
        "skinning_expected.hex",
        ["skinning_influences.hex", "skinning_vectors.hex"],
        [("vertex", "skinning_vectors.hex"), ("influence", "skinning_influences.hex")],
    ),
}


def files_of(two_levels):
    """All files of the table *Files*, in its order."""
    table = list(FILES)
    for unit, care in UNITS:
        if unit == "ray_transform" and not two_levels:
            continue
        for role in ("stimulus", "expected") + (("care",) if care else ()):
            layout = "%s_%s" % (unit, "stimulus" if role == "stimulus" else "expected")
            table.append(("%s_%s.hex" % (unit, role), unit, role, layout))
    return table


class Folder:
    """A folder of vectors: its manifest, its machine, and the lines of its files."""

    def __init__(self, path, report):
        self.path, self.report = path, report
        self.manifest = self._read_manifest()
        self._machine()
        self.table = files_of(self.two_levels)
        self.lines = {}

    def _read_manifest(self):
        path = os.path.join(self.path, "manifest.json")
        if not os.path.isdir(self.path):
            raise Refused("%s: there is no such folder" % self.path)
        try:
            with open(path, encoding="utf-8") as file:
                manifest = json.load(file)
        except OSError as error:
            raise Refused("%s: cannot be read: %s; name a folder that `dynrt vectors` wrote" % (path, error.strerror))
        except (UnicodeDecodeError, json.JSONDecodeError) as error:
            raise Refused("%s: is not JSON: %s; write the vectors again" % (path, error))
        if not isinstance(manifest, dict) or "dynrt_vectors" not in manifest:
            raise Refused("%s: has no key dynrt_vectors; name a folder that `dynrt vectors` wrote" % path)
        version = manifest["dynrt_vectors"]
        if version != VERSION or isinstance(version, bool):
            found = json.dumps(version)
            raise Refused(
                "%s: dynrt_vectors is %s, but this checker knows version %d; use the checker of the program that wrote it"
                % (path, found, VERSION)
            )
        return manifest

    def value(self, path, kind=int):
        """Returns a value of the manifest; raises a refusal that names the value if it is missing."""
        value = self.manifest
        for key in path.split("."):
            value = value.get(key) if isinstance(value, dict) else None
        if not isinstance(value, kind) or isinstance(value, bool) and kind is int:
            name = {int: "whole number", str: "text", list: "list", dict: "object"}[kind]
            raise Refused("%s/manifest.json: %s is not a %s; write the vectors again" % (self.path, path, name))
        return value

    def _machine(self):
        bits = self.value("number_format.exponent_bits"), self.value("number_format.fraction_bits")
        if not (3 <= bits[0] <= 10 and 2 <= bits[1] <= 23):
            raise Refused("%s/manifest.json: number_format is not one of arithmetic.md" % self.path)
        self.numbers = Numbers(*bits)
        self.rays = self.value("rays_per_packet")
        self.tag_bits = self.value("tag_bits")
        self.scenes = self._scenes()
        self.two_levels = any(scene["levels"] == 2 for scene in self.scenes)
        test = self.value("triangle_test", str)
        if self.rays not in (1, 2, 4, 8) or not 1 <= self.tag_bits <= 32:
            raise Refused("%s/manifest.json: rays_per_packet or tag_bits is out of range" % self.path)
        if test not in ("watertight", "moller-trumbore"):
            raise Refused("%s/manifest.json: triangle_test is neither watertight nor moller-trumbore" % self.path)
        self.watertight = test == "watertight"
        self.layouts = layouts_of(self.numbers.width, self.rays, self.tag_bits, self.watertight, self.two_levels)
        self.units = Units(self.numbers, self.rays, self.watertight, self.layouts)

    def _scenes(self):
        """The manifest's entries of the scenes in memory."""
        keys = ("levels", "triangles", "instances", "first_record", "records", "first_vertex", "vertices")
        scenes = self.value("scenes", list)
        for scene in scenes:
            good = isinstance(scene, dict) and isinstance(scene.get("label"), str)
            good = good and all(isinstance(scene.get(key), int) and scene[key] >= 0 for key in keys)
            if not good or scene["levels"] not in (1, 2):
                raise Refused("%s/manifest.json: scenes has an entry that is not one; write the vectors again" % self.path)
        if not scenes:
            raise Refused("%s/manifest.json: scenes is empty; write the vectors again" % self.path)
        return scenes

    def read(self):
        """Reads all files. A line that does not fit its layout is a mismatch and reads as 0."""
        for file, _, _, layout in self.table:
            self.lines[file] = self._read_lines(file, self.layouts[layout])

    def read_bytes(self, file):
        path = os.path.join(self.path, file)
        try:
            with open(path, "rb") as opened:
                return opened.read()
        except OSError as error:
            raise Refused("%s: cannot be read: %s; write the vectors again" % (path, error.strerror))

    def _read_lines(self, file, layout):
        data = self.read_bytes(file)
        report = self.report
        size = layout.digits + 1
        report.count("lines", data.count(b"\n"))
        if re.fullmatch(b"(?:[0-9a-f]{%d}\n)*" % layout.digits, data):
            lines = [int(data[at : at + layout.digits], 16) for at in range(0, len(data), size)]
        else:
            lines = []
            parts = data.split(b"\n")
            if parts[-1]:
                report.wrong("lines", file, len(parts), "line", "a line feed at the end", "none")
            else:
                parts.pop()
            for number, part in enumerate(parts, 1):
                good = re.fullmatch(b"[0-9a-f]{%d}" % layout.digits, part)
                if not good:
                    words = "%d lower-case hexadecimal digits" % layout.digits
                    report.wrong("lines", file, number, "line", words, part[:40].decode("ascii", "backslashreplace"))
                lines.append(int(part, 16) if good else 0)
        limit = 1 << layout.width
        for number, line in enumerate(lines, 1):
            if line >= limit:
                report.wrong("lines", file, number, "line", "zeros above bit %d" % (layout.width - 1), "%x" % line)
        return lines

    def hash(self, file):
        return hashlib.sha256(self.read_bytes(file)).hexdigest()


class Checker:
    """All checks of one folder."""

    def __init__(self, folder, report, limit, jobs):
        self.folder, self.report, self.limit, self.jobs = folder, report, limit, jobs
        self.numbers, self.units, self.layouts = folder.numbers, folder.units, folder.layouts
        self.rays = folder.rays
        self.lines = folder.lines

    def sample(self, count):
        """The lines to check: all, or `--limit` of them, spread evenly."""
        if self.limit is None or count <= self.limit:
            return range(count)
        return sorted({k * count // self.limit for k in range(self.limit)})

    def same(self, kind, file, number, layout, expected, found):
        """Checks a whole line, `number` from 0, and counts its fields."""
        self.report.count(kind, len(layout.fields))
        if expected == found:
            return True
        for field, lsb, width, what in layout.fields:
            mask = (1 << width) - 1
            want, have = expected >> lsb & mask, found >> lsb & mask
            if want != have:
                self.report.wrong(kind, file, number + 1, field, want, have, self.shower(what, width))
        return False

    def shower(self, what, width):
        return self.numbers.text if what == "number" and width >= self.numbers.width - 1 else str

    def line(self, kind, file, number, found):
        """Line `number` of a file (from 0). If the file is too short, records a mismatch and returns nothing."""
        lines = self.lines[file]
        if number < len(lines):
            return lines[number]
        self.report.wrong(kind, file, len(lines) + 1, "line", "a line", found)
        return None

    # -- The manifest

    def check_manifest(self):
        folder, report, manifest = self.folder, self.report, self.folder.manifest
        kind, file = "manifest", "manifest.json"
        numbers, lines = self.numbers, self.lines
        get = self.layouts["raycast_packets"].get

        def expect(field, expected):
            value = manifest
            for key in field.split("."):
                value = value.get(key) if isinstance(value, dict) else None
            report.expect(kind, file, None, field, expected, value)

        expect("number_format.width", numbers.width)
        expect("number_format.bias", numbers.bias)
        expect("configuration.float.exponent_bits", numbers.exponent_bits)
        expect("configuration.float.fraction_bits", numbers.fraction_bits)
        expect("configuration.packets.rays", self.rays)
        expect("configuration.packets.tag_bits", folder.tag_bits)
        expect("configuration.geometry.triangle_test", "watertight" if folder.watertight else "moller-trumbore")
        packets = lines["raycast_packets.hex"]
        expect("packets", len(packets))
        expect("rays", len(packets) * self.rays)
        for name in ("raycast_rays.hex", "raycast_hits.hex"):
            report.expect(kind, name, None, "lines", len(packets) * self.rays, len(lines[name]))
        for total, file_of, field in (
            ("packet_steps", "raycast_packets.hex", "steps"),
            ("ray_triangle_tests", "raycast_packets.hex", "tests"),
            ("ray_transforms", "raycast_packets.hex", "transforms"),
            ("update_instructions", "update_commands.hex", "instructions"),
            ("nodes_written", "update_commands.hex", "writes"),
            ("skinned_vertices", "skinning_commands.hex", "vertices"),
            ("influences", "skinning_commands.hex", "count"),
        ):
            layout = self.layouts[file_of[:-4]]
            expect(total, sum(layout.get(line, field) for line in lines[file_of]))
        expect("updates", len(lines["update_commands.hex"]))
        expect("skinned_meshes", len(lines["skinning_commands.hex"]))
        clock = folder.value("configuration.clock.target_mhz")
        expect("update_machine.vertex_registers", folder.value("configuration.update.vertex_registers"))
        expect("update_machine.box_registers", folder.value("configuration.update.box_registers"))
        expect("update_machine.merge_distance", 4 if clock < 70 else 5 if clock < 120 else 8)
        for key in ("levels", "triangles", "instances"):
            expect(key, folder.scenes[0][key])
        made = folder.value("made", dict)
        size = folder.value("picture.size", list)
        expect("made.size", size)
        expect("picture.packets", sum(get(line, "block") != ALL_ONES for line in packets))
        block = {1: [1, 1], 2: [2, 1], 4: [2, 2], 8: [4, 2]}[self.rays]
        expect("picture.block", block)
        expect("picture.blocks", [-(-side // of) for side, of in zip(size, block)])
        report.expect(kind, file, None, "made", True, {"command", "size", "limit", "clip", "seconds", "camera", "log2_scale"} <= set(made))
        self._check_scene_list()
        self._check_units()
        self._check_pipelines()
        self._check_machine()
        self._check_files()
        self._check_layouts()

    def _check_scene_list(self):
        """Checks that scenes are consecutive, and that their levels are those of their roots."""
        report, kind = self.report, "manifest"
        record = vertex = 0
        for k, scene in enumerate(self.folder.scenes):
            field = "scenes: %s: " % scene["label"]
            report.expect(kind, "manifest.json", None, field + "first_record", record, scene["first_record"])
            report.expect(kind, "manifest.json", None, field + "first_vertex", vertex, scene["first_vertex"])
            report.expect(kind, "manifest.json", None, field + "records", scene["triangles"] + scene["instances"], scene["records"])
            record, vertex = record + scene["records"], vertex + scene["vertices"]
            if k < len(self.lines["scene.hex"]):
                root = link_fields(self.layouts["scene"].get(self.lines["scene.hex"][k], "root"))
                report.expect(kind, "scene.hex", k + 1, "root: right_leaf", scene["levels"] - 1, root["right_leaf"])
            good = scene["instances"] > 0 if scene["levels"] == 2 else scene["instances"] == 0
            report.claim(kind, "manifest.json", None, field + "instances", good, "0 of one level, more of two", scene["instances"])
        for file, count in (
            ("nodes.hex", record),
            ("records.hex", record),
            ("vertices.hex", vertex),
            ("scene.hex", len(self.folder.scenes)),
        ):
            report.expect(kind, file, None, "lines", count, len(self.lines[file]))

    def _check_units(self):
        wanted = {}
        for unit, care in UNITS:
            if unit == "ray_transform" and not self.folder.two_levels:
                continue
            names = ["%s_%s.hex" % (unit, role) for role in ("stimulus", "expected", "care")]
            module = {"packet_step": "tpu_slice", "ray_transform": "raycast_unit"}.get(unit, LIBRARY.get(unit, (unit, {}))[0])
            wanted[unit] = (module, names[0], names[1], names[2] if care else None, [], [])
        for unit, (module, stimulus, expected, others, memories) in WHOLE_UNITS.items():
            wanted[unit] = (module, stimulus, expected, None, others, memories)
        found = {}
        for entry in self.folder.value("units", list):
            if isinstance(entry, dict):
                found[entry.get("unit")] = entry
        for unit, (module, stimulus, expected, care, others, memories) in wanted.items():
            entry = found.get(unit, {})
            for key, value in (
                ("module", PREFIX + module),
                ("copies", self.rays if unit == "packet_step" else 1),
                ("transactions", len(self.lines[stimulus])),
                ("stimulus", stimulus),
                ("expected", expected),
                ("care", care),
                ("others", sorted(others)),
            ):
                given = entry.get(key)
                given = sorted(map(str, given)) if isinstance(given, list) else given
                self.report.expect("manifest", "manifest.json", None, "units: %s: %s" % (unit, key), value, given)
            self._check_memories(unit, memories, entry)
            self._check_ports(unit, entry)
        self.report.expect("manifest", "manifest.json", None, "units", sorted(wanted), sorted(map(str, found)))

    def check_filler(self, kind, file, first, end):
        """A filler: all numbers are NaN, all other bits are 1."""
        layout = self.layouts[file[:-4]]
        line = 0
        for _, lsb, width, what in layout.fields:
            # A weight has no sign bit; its sign is 0.
            line |= (self.numbers.nan if what == "number" else (1 << width) - 1) << lsb
        for place in range(first, min(end, len(self.lines[file]))):
            self.same(kind, file, place, layout, line, self.lines[file][place])

    def check_canonical(self, file, layout):
        """Checks that the numbers of a file are canonical and not −0."""
        numbers, report = self.numbers, self.report
        fields = [field for field in self.layouts[layout].fields if field[2] and field[3] == "number"]
        report.count("canonical numbers", len(fields) * len(self.lines[file]))
        for place, line in enumerate(self.lines[file]):
            for field, lsb, width, _ in fields:
                bits = line >> lsb & (1 << width) - 1
                if not numbers.canonical(bits):
                    report.wrong("canonical numbers", file, place + 1, field, "a canonical number, not -0", bits, numbers.text)

    def _check_memories(self, unit, memories, entry):
        """Checks the read ports: names, images, and widths that follow from the layouts and the ports."""
        given = entry.get("memories")
        given = [memory for memory in given if isinstance(memory, dict)] if isinstance(given, list) else []
        field = "units: %s: memories" % unit
        pairs = [(memory.get("ports"), memory.get("image")) for memory in given]
        self.report.expect("manifest", "manifest.json", None, field, memories, pairs)
        address_bits = self.folder.value("configuration.tree.address_bits")
        ports = {port.get("port"): port for port in entry.get("ports", []) if isinstance(port, dict)}
        machine = self.folder.value("machine", dict)
        for memory in given:
            image, name = str(memory.get("image")), str(memory.get("ports"))
            name = "update_" + name if unit == "update" and "update_%s_request_tag" % name in ports else name
            layout = self.layouts.get(image[:-4])
            expect = self.report.expect
            place = "%s: %s: " % (field, name)
            expect("manifest", "manifest.json", None, place + "address_bits", address_bits, memory.get("address_bits"))
            expect("manifest", "manifest.json", None, place + "data_bits", layout.width if layout else None, memory.get("data_bits"))
            tag = {
                ("raycast", "vertex"): "vertex_tag_bits",
                ("skinning", "vertex"): "vertex_tag_bits",
                ("skinning", "influence"): "influence_tag_bits",
                ("update", "program"): "update_program_tag_bits",
                ("update", "vertex"): "update_vertex_tag_bits",
            }.get((unit, memory.get("ports")))
            if tag:
                expect("manifest", "manifest.json", None, place + "tag_bits", machine.get(tag), memory.get("tag_bits"))
            for end, key in (("request_address", "address_bits"), ("request_tag", "tag_bits"), ("response_data", "data_bits")):
                port = ports.get("%s_%s" % (name, end), {})
                expect("manifest", "manifest.json", None, "units: %s: %s_%s" % (unit, name, end), memory.get(key), port.get("width"))

    def _check_ports(self, unit, entry):
        """Checks the map from fields to ports: fields exist, fit their ports, and have the stated widths."""
        report, name = self.report, "units: %s: ports: " % unit
        stages = {p.get("module"): p.get("stages") for p in self.folder.value("pipelines", list) if isinstance(p, dict)}
        stages = stages.get(entry.get("module")) or {}
        copies, ports = entry.get("copies"), entry.get("ports")
        ports = ports if isinstance(ports, list) else []
        for port in ports:
            port = port if isinstance(port, dict) else {}
            width, use, place = port.get("width"), port.get("use"), name + str(port.get("port"))
            good = isinstance(width, int) and width > 0 and port.get("direction") in ("input", "output")
            good = good and isinstance(port.get("copy"), int) and isinstance(copies, int) and 0 <= port["copy"] < copies
            good = good and use in PORT_USES
            report.claim("manifest", "manifest.json", None, place, good, "a port", json.dumps(port)[:60])
            if not good:
                continue
            if port["direction"] == "input" and port.get("port") in stages:
                report.expect("manifest", "manifest.json", None, place + ": stage", stages[port["port"]], port.get("stage"))
            fields = list(port.get("fields") or [])
            report.claim("manifest", "manifest.json", None, place, bool(fields) == (use in ("fields", "select")), "fields", use)
            for field in fields:
                self._check_port_field(place, width, field)
            if use == "fields":
                bits = sorted((f["port_lsb"], f["port_lsb"] + f["width"]) for f in fields)
                # The upper bits of an output may belong to no field, such as the link word of a written node.
                tiled = [0] + [end for _, end in bits[:-1]] == [first for first, _ in bits]
                tiled = tiled and (bits[-1][1] == width or bits[-1][1] < width and port["direction"] == "output")
                report.claim("manifest", "manifest.json", None, place, tiled, "fields that fill %d bits" % width, bits)
            if use == "select":
                self._check_selector(place, port.get("by"), len(fields))
            elif use == "constant":
                value = port.get("value")
                good = isinstance(value, int) and 0 <= value < 1 << width
                report.claim("manifest", "manifest.json", None, place, good, "a value of %d bits" % width, value)
        names = [(port.get("copy"), port.get("port")) for port in ports if isinstance(port, dict)]
        report.expect("manifest", "manifest.json", None, name + "names", len(names), len(set(names)))

    def _check_port_field(self, place, width, field):
        layout = self.layouts.get(field.get("layout"))
        at = layout.at.get(field.get("field")) if layout else None
        lsb, bits, port_lsb = field.get("lsb"), field.get("width"), field.get("port_lsb")
        good = at is not None and all(isinstance(n, int) for n in (lsb, bits, port_lsb))
        good = good and lsb >= 0 and bits > 0 and lsb + bits <= at[1].bit_length() and 0 <= port_lsb <= width - bits
        shown_field = "%s.%s [%s +%s] at %s" % (field.get("layout"), field.get("field"), lsb, bits, port_lsb)
        self.report.claim("manifest", "manifest.json", None, place, good, "a field within %d bits" % width, shown_field)

    def _check_selector(self, place, by, choices):
        by = by if isinstance(by, dict) else {}
        layout = self.layouts.get(by.get("layout"))
        good = layout is not None and by.get("field") in layout.at and choices > 1
        self.report.claim("manifest", "manifest.json", None, place, good, "a field that selects", json.dumps(by))

    def _check_pipelines(self):
        entries = self.folder.value("pipelines", list)
        units = [entry.get("unit") if isinstance(entry, dict) else None for entry in entries]
        self.report.expect("manifest", "manifest.json", None, "pipelines", PIPELINES, units)
        for entry in entries:
            entry = entry if isinstance(entry, dict) else {}
            name, latency, stages = entry.get("unit"), entry.get("latency"), entry.get("stages")
            good = isinstance(latency, int) and latency > 0
            field = "pipelines: %s: " % name
            self.report.claim("manifest", "manifest.json", None, field + "latency", good, "cycles", latency)
            good = good and isinstance(stages, dict) and all(isinstance(n, int) and 0 <= n <= latency for n in stages.values())
            self.report.claim("manifest", "manifest.json", None, field + "stages", good, "at most the latency", stages)
            module, parameters = LIBRARY.get(name, (name, {}))
            self.report.expect("manifest", "manifest.json", None, field + "module", "%s%s" % (PREFIX, module), entry.get("module"))
            self.report.expect("manifest", "manifest.json", None, field + "parameters", parameters, entry.get("parameters"))
            self.report.expect("manifest", "manifest.json", None, field + "macros", (PREFIX + str(name)).upper(), entry.get("macros"))

    def _check_machine(self):
        """Checks the widths and settings that follow from the configuration."""
        value, machine = self.folder.value, self.folder.value("machine", dict)
        configuration = "configuration."
        wanted = {
            "number_bits": self.numbers.width,
            "exponent_bits": self.numbers.exponent_bits,
            "rays_per_packet": self.rays,
            "ray_bits": max(1, bits_of(self.rays)),
            "packet_bits": max(1, bits_of(value(configuration + "packets.in_flight"))),
            "influence_row_bits": self.layouts["skinning_influences"].width,
            "joint_count_bits": value(configuration + "skinning.joints").bit_length(),
            "node_lanes": 5,
            "tag_bits": self.folder.tag_bits,
            "address_bits": value(configuration + "tree.address_bits"),
            "memory_latency": value(configuration + "memory.latency"),
            "memory_jitter": value(configuration + "memory.jitter"),
            "memory_ready_percent": value(configuration + "memory.ready_percent"),
            "packet_step_stimulus_ray_stride": 8 * self.numbers.width + 3,
            "watertight": self.folder.watertight,
            "two_levels": self.folder.two_levels,
            "memory_in_order": value(configuration + "memory.order", str) == "in-order",
        }
        for key, expected in wanted.items():
            self.report.expect("manifest", "manifest.json", None, "machine: " + key, expected, machine.get(key))
        widths = ["influence_tag_bits", "update_program_tag_bits", "update_vertex_tag_bits", "vertex_tag_bits"]
        self.report.expect("manifest", "manifest.json", None, "machine", sorted(set(wanted) | set(widths)), sorted(machine))

    def _check_files(self):
        report, folder = self.report, self.folder
        found = {}
        for entry in folder.value("files", list):
            if isinstance(entry, dict):
                found[entry.get("file")] = entry
        wanted = [(file, unit, role, layout, len(self.lines[file])) for file, unit, role, layout in folder.table]
        macros = folder.read_bytes("vectors.vh").count(b"\n")
        wanted.append(("vectors.vh", "sim", "macros", None, macros))
        for file, unit, role, layout, lines in wanted:
            entry = found.get(file, {})
            for key, value in (("unit", unit), ("role", role), ("layout", layout), ("lines", lines)):
                report.expect("manifest", "manifest.json", None, "files: %s: %s" % (file, key), value, entry.get(key))
            report.expect("checksums", file, None, "sha256", entry.get("sha256"), folder.hash(file))
            self._check_parts(file, entry, lines)
        names = sorted(entry[0] for entry in wanted)
        report.expect("manifest", "manifest.json", None, "files", names, sorted(map(str, found)))
        names.append("manifest.json")
        report.expect("manifest", "", None, "the folder", sorted(names), sorted(os.listdir(folder.path)))

    def _check_parts(self, file, entry, lines):
        """Checks that the parts are consecutive from line 0 and cover the whole file."""
        parts = entry.get("parts")
        parts = parts if isinstance(parts, list) else []
        place, good = 0, bool(parts)
        for part in parts:
            good = good and isinstance(part, dict) and part.get("first") == place
            good = good and isinstance(part.get("lines"), int) and part["lines"] > 0
            good = good and isinstance(part.get("label"), str) and part["label"] != ""
            if not good:
                break
            place += part["lines"]
        field = "files: %s: parts" % file
        self.report.claim("manifest", "manifest.json", None, field, good, "runs of lines", json.dumps(parts)[:60])
        self.report.expect("manifest", "manifest.json", None, field, lines, place)

    def part(self, file, label):
        """The lines (first, count) of the part of a file with this label; (0, 0) if there is none."""
        for entry in self.folder.value("files", list):
            if entry.get("file") == file:
                for part in entry["parts"]:
                    if part["label"] == label:
                        return part["first"], part["lines"]
        return 0, 0

    def _check_layouts(self):
        found = self.folder.value("layouts", dict)
        for name, layout in list(self.layouts.items()) + [("link_word", LINK_WORD), ("instance", INSTANCE)]:
            entry = found.get(name)
            entry = entry if isinstance(entry, dict) else {}
            for key in ("width", "digits"):
                field = "layouts: %s: %s" % (name, key)
                self.report.expect("layouts", "manifest.json", None, field, getattr(layout, key), entry.get(key))
            fields = entry.get("fields")
            fields = fields if isinstance(fields, list) else []
            given = [tuple(f.get(k) for k in ("name", "lsb", "width", "kind")) if isinstance(f, dict) else f for f in fields]
            for place, want in enumerate(layout.fields):
                have = given[place] if place < len(given) else None
                self.report.expect("layouts", "manifest.json", None, "layouts: %s: %s" % (name, want[0]), want, have)
            self.report.expect("layouts", "manifest.json", None, "layouts: %s: fields" % name, len(layout.fields), len(given))
        missing = sorted(set(found) - set(self.layouts) - {"link_word", "instance"})
        self.report.expect("layouts", "manifest.json", None, "layouts", [], missing)

    # -- The macros

    def check_macros(self):
        """Checks every macro of vectors.vh against the manifest."""
        file, kind = "vectors.vh", "macros"
        text = self.folder.read_bytes(file).decode("utf-8", "replace")
        values = self._macros()
        seen = set()
        for number, line in enumerate(text.splitlines(), 1):
            words = line.split()
            if not words or words[0].startswith("//"):
                continue
            name, value = (words + ["", ""])[1:3]
            good = words[0] == "`define" and len(words) <= 3 and name not in seen
            self.report.claim(kind, file, number, "macro", good, "a macro, once", line)
            seen.add(name)
            self.report.expect(kind, file, number, name, values.get(name, "no such macro"), value)
        self.report.expect(kind, file, None, "macros that are missing", [], sorted(set(values) - seen))

    def _macros(self):
        """All macros; one without a value is only defined."""
        values = {}
        for key, value in self.folder.value("machine", dict).items():
            if value is not False:
                values["DYNRT_" + key.upper()] = "" if value is True else str(value)
        for entry in self.folder.value("pipelines", list):
            values[entry["macros"] + "_LATENCY"] = str(entry["latency"])
            for name, stage in entry["stages"].items():
                values["%s_%s_STAGE" % (entry["macros"], name.upper())] = str(stage)
        for file, _, _, layout_name in self.folder.table:
            layout, prefix = self.layouts[layout_name], "DYNRT_" + file[:-4].upper()
            values[prefix + "_LINES"] = str(len(self.lines[file]))
            values[prefix + "_BITS"] = str(layout.width)
            for field, lsb, width, _ in layout.fields:
                values["%s_%s" % (prefix, field.upper())] = "%d:%d" % (lsb + width - 1, lsb)
                values["%s_%s_LSB" % (prefix, field.upper())] = str(lsb)
        return values


# How a port is used: the last table of *Manifest*.
PORT_USES = ("fields", "select", "constant", "identity", "handshake", "memory", "clock", "reset", "unused")


def bits_of(count):
    """The number of bits of an index below `count`."""
    return (count - 1).bit_length()


LINK_WORD = Layout(
    "link_word",
    [
        ("link", 26, "unsigned"),
        ("left_leaf", 1, "flag"),
        ("right_leaf", 1, "flag"),
        ("left_axis", 2, "unsigned"),
        ("right_axis", 2, "unsigned"),
    ],
)


INSTANCE = Layout(
    "instance",
    [("vectors", 32, "unsigned"), ("root", 32, "unsigned"), ("unused", 32, "unsigned"), ("number", 32, "unsigned")],
)


def link_fields(word):
    return {name: LINK_WORD.get(word, name) for name, _, _, _ in LINK_WORD.fields}


# ---- Memory images -------------------------------------------------------------------------------------------------


class Block:
    """An object's consecutive slots in memory: layout.md, *Where things lie*."""

    def __init__(self, root, base, slots, box, depth):
        self.root, self.base, self.slots, self.box, self.depth = root, base, slots, box, depth


class Memory:
    """nodes.hex, records.hex and vertices.hex, which all scenes share."""

    def __init__(self, checker):
        layouts, lines, numbers = checker.layouts, checker.lines, checker.numbers
        self.nodes = [checker.units.node_of(line) for line in lines["nodes.hex"]]
        self.records = [tuple(line >> 32 * k & ALL_ONES for k in range(4)) for line in lines["records.hex"]]
        vertex = layouts["vertices"]
        self.vertex_bits = [tuple(vertex.get(line, axis) for axis in AXES) for line in lines["vertices.hex"]]
        self.vertices = [tuple(map(numbers.decode, bits)) for bits in self.vertex_bits]


class Scene:
    """One scene in memory: its registers, its slots, and the structure of its trees."""

    def __init__(self, checker, memory, number):
        self.checker, self.memory, self.number = checker, memory, number
        self.report, self.numbers = checker.report, checker.numbers
        self.nodes, self.records = memory.nodes, memory.records
        self.vertices, self.vertex_bits = memory.vertices, memory.vertex_bits
        said = checker.folder.scenes[number]
        self.two_levels, self.instances = said["levels"] == 2, said["instances"]
        self.first, self.end = said["first_record"], said["first_record"] + said["records"]
        self.first_vertex, self.end_vertex = said["first_vertex"], said["first_vertex"] + said["vertices"]
        layout, lines = checker.layouts["scene"], checker.lines["scene.hex"]
        path = checker.folder.path
        if number >= len(lines):
            raise Refused("%s/scene.hex: has no line for scene %d; write the vectors again" % (path, number))
        if self.end > min(len(self.nodes), len(self.records)) or self.end_vertex > len(self.vertices) or self.first == self.end:
            raise Refused("%s/manifest.json: scene %d is not within the images; write the vectors again" % (path, number))
        self.root = link_fields(layout.get(lines[number], "root"))
        self.box = tuple(tuple(map(self.numbers.decode, layout.vector(lines[number], corner))) for corner in ("lo", "hi"))
        self.blocks = []

    def triangle(self, index):
        """The vertices of the triangle in a record."""
        return tuple(self.vertices[v] for v in self.records[index][:3])

    def check(self):
        self._check_root(self.root, "scene.hex", self.number + 1, self.two_levels)
        below = 0
        if self.two_levels:
            middle = self.end - self.instances
            self._check_instances(middle, self.end)
            self._find_objects(middle)
            top = self._walk(self.root, middle, self.end, True)
            below = max(block.depth for block in self.blocks)
        else:
            top = self._walk(self.root, self.first, self.end, False)
            self.blocks = [top]
        self._check_depth(top, below)
        self._check_scene_box(top)

    def _check_root(self, root, file, line, top):
        report = self.report
        report.expect("memory", file, line, "root: right_leaf", int(top), root["right_leaf"])
        report.expect("memory", file, line, "root: axes", (0, 0), (root["left_axis"], root["right_axis"]))

    def _check_depth(self, top, below):
        deepest = self.checker.folder.value("configuration.tree.stack_depth")
        depth = top.depth + below
        words = "at most %d" % deepest
        self.report.claim("memory", "nodes.hex", None, "depth", depth <= deepest, words, depth)

    def _check_scene_box(self, top):
        layout, line = self.checker.layouts["scene"], self.checker.lines["scene.hex"][self.number]
        encode = self.numbers.encode
        expected = layout.put_vector("lo", map(encode, top.box[0])) | layout.put_vector("hi", map(encode, top.box[1]))
        expected |= layout.get(line, "root")
        self.checker.same("memory", "scene.hex", self.number, layout, expected, line)

    def _check_instances(self, first, end):
        report, seen = self.report, set()
        taken = set()
        for index in range(first, end):
            vectors, root, unused, number = self.records[index]
            line = index + 1
            good = self.first_vertex <= vectors and vectors + 6 <= self.end_vertex
            report.claim("memory", "records.hex", line, "vectors", good, "six vectors of the scene", vectors)
            if vectors + 6 > len(self.vertices):
                raise Refused("%s/records.hex: line %d: vectors %d lie beyond vertices.hex" % (self.checker.folder.path, line, vectors))
            report.claim("memory", "records.hex", line, "vectors", taken.isdisjoint(range(vectors, vectors + 6)), "vectors of its own", vectors)
            taken.update(range(vectors, vectors + 6))
            self._check_root(link_fields(root), "records.hex", line, False)
            report.expect("memory", "records.hex", line, "unused", 0, unused)
            good = number < end - first and number not in seen
            report.claim("memory", "records.hex", line, "number", good, "a number below %d, once" % (end - first), number)
            seen.add(number)
            lo, hi = self.vertices[vectors + 4], self.vertices[vectors + 5]
            good = all(a <= b for a, b in zip(lo, hi))
            report.claim("memory", "vertices.hex", vectors + 5, "lo", good, "lo <= hi", "%s, %s" % (lo, hi))

    def _find_objects(self, end):
        """Finds the objects that instances name, in the order of their slots."""
        roots = {self.records[index][1] for index in range(end, self.end)}
        # The last slot of an object is the one after its root node, or the record of its only triangle.
        ends = [(root["link"] + (1 if root["left_leaf"] else 2), root["link"], root) for root in map(link_fields, roots)]
        ends.sort(key=lambda entry: entry[:2])
        base = self.first
        for last, _, root in ends:
            block = self._walk(root, None, last, False)
            self.report.claim("memory", "nodes.hex", last, "object", block.base >= base, "slots of its own", block.base)
            base = last
            self.blocks.append(block)

    def _walk(self, root, base, end, top):
        """Checks the tree of an object, or the top-level tree. Its slots start at `base`, if that is known, and end at `end`."""
        if root["left_leaf"]:
            if root["link"] >= len(self.records):
                raise Refused("%s: a root names record %d, beyond records.hex" % (self.checker.folder.path, root["link"]))
            box = self._leaf_box(root["link"], top)
            base = root["link"] if base is None else base
            self._check_slots(base, end, {root["link"]: 1}, top)
            return Block(root, base, end - base, box, 0)
        nodes, leaves = self._reach(root["link"])
        lowest = min(min(nodes), min(leaves))
        base = lowest if base is None else base
        boxes, depths = {}, {}
        for index in sorted(nodes):
            self._check_node(index, boxes, depths, top)
        self.report.expect("memory", "nodes.hex", end, "root", end - 2, root["link"])
        self.report.expect("memory", "nodes.hex", end, "nodes", end - base - 1, len(nodes))
        self._check_slots(base, end, leaves, top)
        return Block(root, base, end - base, boxes[root["link"]], depths[root["link"]])

    def _reach(self, root):
        """The nodes below a root, and the number of leaves per record. A child whose index is not below its parent's is a mismatch."""
        nodes, leaves, stack = set(), collections.Counter(), [root]
        while stack:
            index = stack.pop()
            if index >= len(self.nodes):
                raise Refused("%s: a link names node %d, beyond nodes.hex" % (self.checker.folder.path, index))
            if index in nodes:
                self.report.wrong("memory", "nodes.hex", index + 1, "node", "one parent", "two")
                continue
            nodes.add(index)
            for child, leaf in children_of(index, self.nodes[index]):
                if leaf:
                    if child >= len(self.records):
                        raise Refused("%s: node %d names record %d, beyond records.hex" % (self.checker.folder.path, index, child))
                    leaves[child] += 1
                    continue
                self.report.count("memory")
                if child < index:
                    stack.append(child)
                else:
                    self.report.wrong("memory", "nodes.hex", index + 1, "link", "a child before its parent", child)
                    raise Refused("%s/nodes.hex: line %d: a child does not come before its parent" % (self.checker.folder.path, index + 1))
        return nodes, leaves

    def _check_node(self, index, boxes, depths, top):
        """Checks axes and bounds. Children come before their parents, so their boxes are known."""
        node, report = self.nodes[index], self.report
        axes = node.left_axis, node.right_axis
        report.claim("memory", "nodes.hex", index + 1, "axes", 3 not in axes, "0, 1 or 2", axes)
        if self.checker.folder.value("configuration.tree.axes_per_node") == 1:
            report.claim("memory", "nodes.hex", index + 1, "axes", axes[0] == axes[1], "one axis", axes)
        box, depth, bounds = None, 0, 0
        width = self.numbers.width
        for side, (child, leaf) in enumerate(children_of(index, node)):
            if leaf:
                child_box = self._leaf_box(child, top)
            else:
                child_box = boxes[child]
                depth = max(depth, depths[child])
            box = child_box if box is None else join(box, child_box)
            axis = min(axes[side], 2)
            for end in (0, 1):
                bounds |= self.numbers.encode(child_box[end][axis]) << (2 * side + end) * width
        layout = self.checker.layouts["nodes"]
        upper = node.line >> 4 * width << 4 * width
        self.checker.same("memory", "nodes.hex", index, layout, upper | bounds, node.line)
        boxes[index], depths[index] = box, depth + 1

    def _leaf_box(self, index, top):
        if top:
            vectors = self.records[index][0]
            return self.vertices[vectors + 4], self.vertices[vectors + 5]
        corners = self.records[index][:3]
        good = self.first_vertex <= min(corners) and max(corners) < self.end_vertex
        self.report.claim("memory", "records.hex", index + 1, "vertices", good, "vertices of the scene", corners)
        if max(corners) >= len(self.vertices):
            raise Refused("%s/records.hex: line %d: vertex %d lies beyond vertices.hex" % (self.checker.folder.path, index + 1, max(corners)))
        return box_of(self.vertices[v] for v in corners)

    def _check_slots(self, base, end, leaves, top):
        """Checks that each record and each number of a triangle occurs once, and that the last node slot is 0."""
        report = self.report
        for index in range(base, end):
            report.expect("memory", "records.hex", index + 1, "leaves that name the record", 1, leaves.get(index, 0))
        beyond = [index for index in leaves if not base <= index < end]
        report.expect("memory", "records.hex", end, "records of another object", [], beyond)
        line = self.nodes[end - 1].line
        report.expect("memory", "nodes.hex", end, "unused slot", 0, line)
        if not top:
            numbers = sorted(self.records[index][3] for index in range(base, end))
            for place, number in enumerate(numbers):
                report.expect("memory", "records.hex", None, "number of a triangle of the object at %d" % base, place, number)


def join(a, b):
    """The union of two boxes."""
    return tuple(map(min, a[0], b[0])), tuple(map(max, a[1], b[1]))


def box_of(points):
    points = list(points)
    return tuple(map(min, *points)), tuple(map(max, *points))


# ---- Ray casting ---------------------------------------------------------------------------------------------------


class Space:
    """The space that a packet traverses: the world, or an instance's object space."""

    __slots__ = ("rays", "instance", "object")

    def __init__(self, rays, instance, is_object):
        self.rays, self.instance, self.object = rays, instance, is_object


class Caster:
    """The traversal of arithmetic.md in the memory images, with a record of all steps, tests and transformations."""

    def __init__(self, units, scene):
        self.units, self.memory = units, scene
        self.two_levels = scene.two_levels

    def cast(self, rays):
        """Returns (hits, steps, tests, transforms); the last three are lists of stimulus lines."""
        self.steps, self.tests, self.transforms = [], [], []
        self.limits = [INF] * len(rays)
        self.hits = [(INF, 0.0, 0.0, ALL_ONES, ALL_ONES)] * len(rays)
        self.world = Space(rays, 0, False)
        mask = sum((ray.valid and ray.near <= ray.far) << k for k, ray in enumerate(rays))
        if mask:
            nears, fars = [ray.near for ray in rays], [ray.far for ray in rays]
            root = self.memory.root
            self._run(self.world, root["link"], bool(root["left_leaf"]), mask, nears, fars)
        return self.hits, self.steps, self.tests, self.transforms

    def _run(self, space, index, leaf, mask, nears, fars):
        units, memory, stack = self.units, self.memory, []
        while True:
            if not leaf:
                node = memory.nodes[index]
                self.steps.append(units.step_stimulus(index, node, mask, space.rays, nears, fars))
                step = units.step(index, node, mask, space.rays, nears, fars)
                if step.goes_on:
                    first, second = (step.left, step.right) if step.left_first else (step.right, step.left)
                    if step.pushed is not None:
                        stack.append((space, step.pushed, second))
                    index, leaf = step.next
                    mask, nears, fars = spread(first, len(self.limits))
                    continue
            elif self.two_levels and not space.object:
                entered = self._enter(index, mask)
                if entered is not None:
                    space, index, leaf, mask, nears, fars = entered
                    continue
            else:
                self._test_all(space, index, mask)
            popped = self._pop(stack)
            if popped is None:
                return
            space, index, leaf, mask, nears, fars = popped

    def _pop(self, stack):
        while stack:
            space, (index, leaf), entry = stack.pop()
            staying = {}
            for k, (near, far) in entry.items():
                limit = self.limits[k]
                if near <= limit:
                    staying[k] = near, (limit if limit < far else far)
            if staying:
                return (space, index, leaf) + spread(staying, len(self.limits))
        return None

    def _enter(self, index, mask):
        """The dispatch of an instance: its object's root with the rays that enter, or nothing."""
        units, memory = self.units, self.memory
        vectors, root, _, number = memory.records[index]
        bits = memory.vertex_bits[vectors : vectors + 6]
        points = memory.vertices[vectors : vectors + 6]
        rays, entering = list(self.world.rays), {}
        for k in range(len(rays)):
            if not mask >> k & 1:
                continue
            ray = self.world.rays[k]
            self.transforms.append(units.transform_stimulus(k, index, bits, ray))
            moved = units.transform(points[:4], (points[4], points[5]), ray)
            rays[k] = moved
            near_w, far_w = moved.window
            near = near_w if near_w > ray.tmin else ray.tmin
            far = far_w if far_w < ray.tmax else ray.tmax
            if all(x == x for x in moved.o + moved.d) and near <= far:
                entering[k] = near, far
        if not entering:
            return None
        fields = link_fields(root)
        space = Space(rays, number, True)
        return (space, fields["link"], bool(fields["left_leaf"])) + spread(entering, len(rays))

    def _test_all(self, space, index, mask):
        units, memory = self.units, self.memory
        record = memory.records[index]
        bits = [memory.vertex_bits[v] for v in record[:3]]
        corners = [memory.vertices[v] for v in record[:3]]
        for k, ray in enumerate(space.rays):
            if not mask >> k & 1:
                continue
            world = self.world.rays[k]
            self.tests.append(units.test_stimulus(k, index, bits, ray, world.tmin, world.tmax))
            hit = units.test(ray, corners, world.tmin, world.tmax)
            if hit is not None:
                self.hits[k], self.limits[k] = merged(self.hits[k], world, hit, space.instance, record[3])

    def brute_force(self, ray):
        """The hit of a ray by tests against all triangles, without a tree."""
        best = (INF, 0.0, 0.0, ALL_ONES, ALL_ONES)
        if not ray.valid:
            return best
        memory = self.memory
        places = [(ray, 0, block) for block in memory.blocks]
        if self.two_levels:
            places = self._placed(ray)
        for moved, instance, block in places:
            for index in range(block.base, block.base + block.slots):
                hit = self.units.test(moved, memory.triangle(index), ray.tmin, ray.tmax)
                if hit is not None:
                    best, _ = merged(best, ray, hit, instance, memory.records[index][3])
                    if ray.any_hit:
                        return best
        return best

    def _placed(self, ray):
        """The ray in the object space of each instance whose box it meets, with the object's slots."""
        memory, units = self.memory, self.units
        blocks = {(block.root["link"], block.root["left_leaf"]): block for block in memory.blocks}
        places = []
        for index in range(memory.end - memory.instances, memory.end):
            vectors, root, _, number = memory.records[index]
            points = memory.vertices[vectors : vectors + 6]
            moved = units.transform(points[:4], (points[4], points[5]), ray)
            if all(x == x for x in moved.o + moved.d) and moved.window[0] <= moved.window[1]:
                fields = link_fields(root)
                places.append((moved, number, blocks[fields["link"], fields["left_leaf"]]))
        return places


def spread(entry, rays):
    """The mask of a stack entry, and its nears and fars by slot."""
    mask, nears, fars = 0, [0.0] * rays, [INF] * rays
    for k, (near, far) in entry.items():
        mask |= 1 << k
        nears[k], fars[k] = near, far
    return mask, nears, fars


def merged(best, ray, hit, instance, triangle):
    """The closest hit and the limit of a ray after another hit: *Merging a hit*."""
    if ray.any_hit:
        return (ray.tmin, 0.0, 0.0, ALL_ONES, ALL_ONES), -INF
    t, u, v = hit
    if t < best[0] or t == best[0] and (instance, triangle) < best[3:]:
        return (t, u, v, instance, triangle), t
    return best, best[0]


class RayCasting:
    """raycast_*.hex, and the lines of each packet in the units' files."""

    # The number of ray-triangle tests for brute force in all scenes together.
    BRUTE_FORCE = 600_000

    def __init__(self, checker, scenes):
        self.checker, self.scenes = checker, scenes
        self.units, self.rays = checker.units, checker.rays
        self.layout, self.lines = checker.layouts, checker.lines
        self.casters = [Caster(self.units, scene) for scene in scenes]

    def check_serial(self):
        """Checks the tags, scenes, blocks, first lines and rays of all packets."""
        checker, report, file = self.checker, self.checker.report, "raycast_packets.hex"
        layout, tags = self.layout["raycast_packets"], 1 << checker.folder.tag_bits
        firsts = [0, 0, 0]
        last_scene = 0
        for p, line in enumerate(self.lines[file]):
            report.expect("raycast_packets", file, p + 1, "tag", p % tags, layout.get(line, "tag"))
            for place, (first, count) in enumerate((("first_step", "steps"), ("first_test", "tests"), ("first_transform", "transforms"))):
                report.expect("raycast_packets", file, p + 1, first, firsts[place], layout.get(line, first))
                firsts[place] += layout.get(line, count)
            scene = layout.get(line, "scene")
            good = last_scene <= scene <= last_scene + 1 and scene < len(self.scenes)
            report.claim("raycast_packets", file, p + 1, "scene", good, "scene %d or the next" % last_scene, scene)
            last_scene = scene
        report.expect("raycast_packets", file, None, "last scene", len(self.scenes) - 1, last_scene)
        for unit, count in zip(("packet_step", "triangle_test", "ray_transform"), firsts):
            if unit + "_stimulus.hex" in self.lines:
                first, lines = checker.part(unit + "_stimulus.hex", "packets")
                report.expect("raycast_packets", "manifest.json", None, unit + "_stimulus.hex: parts: packets", (0, count), (first, lines))
        self._check_blocks()
        self._check_picture()
        self._check_rays()

    def _check_blocks(self):
        """Checks that the packets of the picture come first, in its order: all of them, or one of each of `limit` equal runs."""
        checker, file = self.checker, "raycast_packets.hex"
        layout, report = self.layout["raycast_packets"], self.checker.report
        value = checker.folder.value
        blocks = value("picture.blocks", list)
        total, count = blocks[0] * blocks[1], value("picture.packets")
        limit = value("made", dict).get("limit")
        wanted = total if limit is None else min(limit, total)
        report.expect("raycast_packets", "manifest.json", None, "picture: packets", wanted, count)
        last_block = -1
        for p, line in enumerate(self.lines[file]):
            block = layout.get(line, "block")
            if p >= count:
                report.expect("raycast_packets", file, p + 1, "block", ALL_ONES, block)
                continue
            # The runs have about equal length; their ends may be rounded up or down.
            loose = 0 if count == total else 1
            first, end = p * total // count - loose, -(-(p + 1) * total // count) + loose
            good = last_block < block and first <= block < end
            report.claim("raycast_packets", file, p + 1, "block", good, "%d to %d" % (max(first, last_block + 1), end - 1), block)
            last_block = block
            report.expect("raycast_packets", file, p + 1, "scene", 0, layout.get(line, "scene"))

    def _check_picture(self):
        """Checks the rays of the picture with the camera of the manifest."""
        checker, numbers, file = self.checker, self.checker.numbers, "raycast_rays.hex"
        value, layout, encode = checker.folder.value, self.layout["raycast_rays"], self.checker.numbers.encode
        camera = value("made.camera", dict)
        eye, forward, right, up = (camera.get(name) for name in ("eye", "forward", "right", "up"))
        (width, height), (across, down) = value("picture.size", list), value("picture.block", list)
        scale = 2.0 ** value("made.log2_scale")
        origin = tuple(encode(numbers.round(x * scale)) for x in eye)
        for p in range(value("picture.packets")):
            block = self.layout["raycast_packets"].get(self.lines["raycast_packets.hex"][p], "block")
            y0, x0 = divmod(block, value("picture.blocks", list)[0])
            for k in range(self.rays):
                found = checker.line("rays of the picture", file, p * self.rays + k, "none")
                if found is None:
                    return
                x, y = across * x0 + k % across, down * y0 + k // across
                u, v = (2 * (x + 0.5) - width) / height, 1 - 2 * (y + 0.5) / height
                direction = [encode(numbers.round(f + u * r + v * w)) for f, r, w in zip(forward, right, up)]
                expected = layout.put_vector("origin", origin) | layout.put_vector("direction", direction)
                expected |= layout.pack(tmax=numbers.inf, active=int(x < width and y < height))
                expected |= layout.get(found, "tag") << layout.at["tag"][0]
                checker.same("rays of the picture", file, p * self.rays + k, layout, expected, found)

    def _check_rays(self):
        """Checks rays and tags. The rays of scene 0 are the first stimulus lines of ray setup."""
        checker, report = self.checker, self.checker.report
        setup, ray_layout = self.layout["ray_setup_stimulus"], self.layout["raycast_rays"]
        packets, get = self.lines["raycast_packets.hex"], self.layout["raycast_packets"].get
        tags, numbers = 1 << checker.folder.tag_bits, checker.numbers
        file, first_scene = "raycast_rays.hex", 0
        for k, line in enumerate(self.lines[file]):
            report.expect("raycast_rays", file, k + 1, "tag", k // self.rays % tags, ray_layout.get(line, "tag"))
            for field, lsb, width, kind in setup.fields:
                if kind == "number":
                    report.count("canonical numbers")
                    bits = line >> lsb & (1 << width) - 1
                    if not numbers.canonical(bits, minus_zero=True):
                        report.wrong("canonical numbers", file, k + 1, field, "a canonical number", bits, numbers.text)
            if k // self.rays < len(packets) and get(packets[k // self.rays], "scene") == 0:
                expected = line & (1 << setup.width) - 1
                have = checker.line("raycast_rays", "ray_setup_stimulus.hex", k, "none")
                if have is not None:
                    checker.same("raycast_rays", "ray_setup_stimulus.hex", k, setup, expected, have)
                first_scene += 1
        part = checker.part("ray_setup_stimulus.hex", "packets")
        report.expect("raycast_rays", "manifest.json", None, "ray_setup_stimulus.hex: parts: packets", (0, first_scene), part)

    def scene_of(self, p):
        """The scene of a packet; scene 0 if the packet names a scene that does not exist."""
        scene = self.layout["raycast_packets"].get(self.lines["raycast_packets.hex"][p], "scene")
        return scene if scene < len(self.scenes) else 0

    def ray(self, k, scene):
        line = self.lines["raycast_rays.hex"][k]
        return self.units.of_setup(line & (1 << self.layout["ray_setup_stimulus"].width) - 1, self.scenes[scene].box)

    def check_packet(self, p):
        checker, report = self.checker, self.checker.report
        first_ray = p * self.rays
        if first_ray + self.rays > len(self.lines["raycast_rays.hex"]):
            return
        scene = self.scene_of(p)
        hits, *events = self.casters[scene].cast([self.ray(first_ray + k, scene) for k in range(self.rays)])
        for k, hit in enumerate(hits):
            self._check_hit("raycast_hits", first_ray + k, hit)
        layout, line = self.layout["raycast_packets"], self.lines["raycast_packets.hex"][p]
        for lines, first, count, unit in zip(
            events,
            ("first_step", "first_test", "first_transform"),
            ("steps", "tests", "transforms"),
            ("packet_step", "triangle_test", "ray_transform"),
        ):
            report.expect("raycast_packets", "raycast_packets.hex", p + 1, count, len(lines), layout.get(line, count))
            file = unit + "_stimulus.hex"
            if file not in self.lines:
                continue
            at = layout.get(line, first)
            for k, expected in enumerate(lines[: layout.get(line, count)]):
                kind = unit + "s of packets"
                found = checker.line(kind, file, at + k, "none")
                if found is None:
                    break
                checker.same(kind, file, at + k, self.layout[unit + "_stimulus"], expected, found)

    def _check_hit(self, kind, k, hit):
        checker, encode = self.checker, self.checker.numbers.encode
        t, u, v, instance, triangle = hit
        layout = self.layout["raycast_hits"]
        expected = layout.pack(t=encode(t), u=encode(u), v=encode(v), instance=instance, triangle=triangle)
        expected |= (k // self.rays) % (1 << checker.folder.tag_bits) << layout.at["tag"][0]
        found = checker.line(kind, "raycast_hits.hex", k, "none")
        if found is not None:
            checker.same(kind, "raycast_hits.hex", k, layout, expected, found)

    def brute_force_rays(self):
        """The rays to cast by brute force: all rays of a small scene; for a large one a limited number, spread evenly."""
        counts = collections.Counter(self.scene_of(p) for p in range(len(self.lines["raycast_packets.hex"])))
        chosen, first = [], 0
        for number in sorted(counts):
            scene, count = self.scenes[number], counts[number] * self.rays
            # An instance costs about as much as two tests, because most rays enter few instances.
            cost = sum(block.slots for block in scene.blocks) + 2 * scene.instances
            wanted = min(count, max(4, self.BRUTE_FORCE // len(counts) // cost))
            if self.checker.limit is not None:
                wanted = min(wanted, self.checker.limit)
            chosen += sorted({first + k * count // wanted for k in range(wanted)})
            first += count
        rays = len(self.lines["raycast_rays.hex"])
        return [k for k in chosen if k < rays]

    def check_brute_force(self, k):
        scene = self.scene_of(k // self.rays)
        self._check_hit("brute force", k, self.casters[scene].brute_force(self.ray(k, scene)))


# ---- Units ---------------------------------------------------------------------------------------------------------


class UnitLines:
    """Checks the expected and care lines of a unit by its stimulus lines."""

    def __init__(self, checker, scene):
        self.checker, self.box = checker, scene.box
        numbers, units = checker.numbers, checker.units
        stimulus = checker.layouts["fp_add_stimulus"]
        shift, one = stimulus.at["b"][0], stimulus.at["a"][1]

        def pair(by_floats, by_bits):
            """A result computed with floats and with integers. The two differ only if this checker has a bug."""

            def result(line):
                a, b = line & one, line >> shift
                y = by_bits(a, b)
                if numbers.encode(by_floats(numbers.decode(a), numbers.decode(b))) != y:
                    raise AssertionError("the checker's own two ways of computing differ: %x, %x" % (a, b))
                return y, one

            return result

        def reciprocal(line):
            y = numbers.reciprocal_bits(line)
            if numbers.encode(numbers.reciprocal(numbers.decode(line))) != y:
                raise AssertionError("the checker's own two ways of computing differ: 1 / %x" % line)
            return y, one

        rounded = numbers.round
        self.compute = {
            "ray_setup": lambda line: units.setup_expected(units.of_setup(line, self.box)),
            "packet_step": lambda line: units.step_expected(units.of_step(line)),
            "triangle_test": lambda line: units.test_expected(units.of_test(line)),
            "ray_transform": lambda line: (units.transform_expected(units.of_transform(line)), None),
            "fp_add": pair(lambda a, b: rounded(a + b), numbers.add_bits),
            "fp_sub": pair(lambda a, b: rounded(a - b), numbers.sub_bits),
            "fp_mul": pair(lambda a, b: rounded(a * b), numbers.mul_bits),
            "fp_reciprocal": reciprocal,
        }
        # Operands of the arithmetic units are arbitrary patterns; all other numbers are canonical.
        self.any_pattern = ("fp_add", "fp_sub", "fp_mul", "fp_reciprocal")

    def check(self, unit, place):
        checker = self.checker
        lines = checker.lines
        stimulus = "%s_stimulus.hex" % unit
        line = lines[stimulus][place]
        expected, care = self.compute[unit](line)
        layout = checker.layouts[unit + "_expected"]
        found = checker.line(unit, unit + "_expected.hex", place, "none")
        if found is not None:
            checker.same(unit, unit + "_expected.hex", place, layout, expected, found)
        if unit + "_care.hex" in lines:
            found = checker.line(unit + " care", unit + "_care.hex", place, "none")
            if found is not None:
                checker.same(unit + " care", unit + "_care.hex", place, layout, care, found)
        if unit not in self.any_pattern:
            self._check_canonical(stimulus, place, checker.layouts[unit + "_stimulus"], line)

    def _check_canonical(self, file, place, layout, line):
        numbers, report = self.checker.numbers, self.checker.report
        canonical = numbers.canonical
        checked = 0
        for field, lsb, width, kind in layout.fields:
            if kind == "number":
                checked += 1
                bits = line >> lsb & (1 << width) - 1
                # -0 occurs only in rays: ray setup passes origin and direction on unchanged.
                of_ray = "origin" in field or "direction" in field or field in ("tmin", "tmax") and self.of_setup(file)
                if not canonical(bits, minus_zero=of_ray):
                    report.wrong("canonical numbers", file, place + 1, field, "a canonical number", bits, numbers.text)
        report.count("canonical numbers", checked)

    @staticmethod
    def of_setup(file):
        return file == "ray_setup_stimulus.hex"

    def check_special_operands(self):
        """Checks that the special operands are the same in three files, and that each operand of the reciprocal is `a` four times."""
        checker, kind = self.checker, "special operands"
        label, lines = "directed: special operands", checker.lines
        layout = checker.layouts["fp_add_stimulus"]
        adds, singles = lines["fp_add_stimulus.hex"], lines["fp_reciprocal_stimulus.hex"]
        count = checker.part("fp_reciprocal_stimulus.hex", label)[1]
        for unit in ("fp_add", "fp_sub", "fp_mul"):
            file = unit + "_stimulus.hex"
            checker.report.expect(kind, "manifest.json", None, file + ": parts", (0, 4 * count), checker.part(file, label))
            for place in range(min(4 * count, len(lines[file]), len(adds))):
                a = singles[place // 4] if place // 4 < len(singles) else 0
                expected = a | layout.get(adds[place], "b") << layout.at["b"][0]
                checker.same(kind, file, place, layout, expected, lines[file][place])

    def check_counts(self):
        """Checks that stimulus, expected and care files have the same number of lines."""
        checker = self.checker
        for unit, _ in UNITS:
            names = [unit + end for end in ("_stimulus.hex", "_expected.hex", "_care.hex")]
            counts = [(name, len(checker.lines[name])) for name in names if name in checker.lines]
            for name, count in counts[1:]:
                checker.report.expect(unit, name, None, "lines", counts[0][1], count)


# ---- Update --------------------------------------------------------------------------------------------------------


class Stopped(Exception):
    """The reason why an update program cannot be executed further."""


class Program:
    """One execution of an update program, as update.md defines it."""

    def __init__(self, data, vertices, vertex_base, node_base, registers, distance):
        self.data, self.vertices = data, vertices
        self.vertex_base, self.node_base = vertex_base, node_base
        self.vertex_registers, self.box_registers = registers
        self.distance = distance
        self.loads, self.leaves, self.nodes = 0, 0, 0
        self.v = {}
        self.unread = set()
        # Per box register: its box, the subtree of that box, and the instruction that wrote it.
        self.boxes = {}
        self.free, self.fresh, self.last = [], 0, None
        self.writes, self.links, self.triangles = [], [], []
        self.instructions = 0
        self.box = None

    def run(self):
        place = 0
        while self.box is None:
            if place >= len(self.data):
                raise Stopped("no end in the rows of the program")
            word = int.from_bytes(self.data[place : place + 5], "little")
            size = self._execute(word)
            place += size
            self.instructions += 1
            if place > len(self.data):
                raise Stopped("an instruction goes on behind the last row")
        if any(self.data[place:]) or len(self.data) - place >= 16:
            raise Stopped("after end not only zeros up to a multiple of 16 bytes")

    def _execute(self, word):
        low = word & 15
        if low & 3 == 3:
            self._load(word >> 2 & 63, None)
            return 1
        if low == 12:
            self._zeros(word, 22, 24)
            self._leaf(word >> 4 & 63, word >> 10 & 63, word >> 16 & 63)
            return 3
        if low == 13:
            if self.last is None:
                raise Stopped("leaf x y before a load")
            self._leaf(word >> 4 & 63, word >> 10 & 63, self.last)
            return 2
        if low == 14:
            return self._special(word)
        self._node(low & 3, low >> 2, word >> 4 & 63, word >> 10 & 63)
        return 2

    def _special(self, word):
        which = word >> 4 & 15
        if which == 0:
            return 1
        if which == 1:
            self._zeros(word, 14, 16)
            register = word >> 8 & 63
            if register not in self.boxes:
                raise Stopped("end of a box register that holds nothing")
            self.box, self.of_end = self.boxes[register][:2]
            return 2
        if which == 2:
            self._zeros(word, 40, 40)
            again = word >> 14 & (1 << 26) - 1
            if again >= self.loads:
                raise Stopped("load of vertex %d before its first load" % again)
            self._load(word >> 8 & 63, again)
            return 5
        raise Stopped("no instruction: %x" % (word & 255))

    @staticmethod
    def _zeros(word, first, end):
        if word >> first & (1 << end - first) - 1:
            raise Stopped("bits %d to %d of an instruction are not 0" % (first, end - 1))

    def _load(self, register, again):
        if register >= self.vertex_registers:
            raise Stopped("vertex register %d" % register)
        if register in self.unread:
            raise Stopped("vertex register %d loaded twice and not read" % register)
        number = self.loads if again is None else again
        if again is None:
            self.loads += 1
        if self.vertex_base + number >= len(self.vertices):
            raise Stopped("vertex %d beyond the memory" % (self.vertex_base + number))
        self.v[register] = number
        self.unread.add(register)
        self.last = register

    def _leaf(self, *registers):
        for register in registers:
            if register not in self.v:
                raise Stopped("vertex register %d holds nothing" % register)
        # The loads before a leaf load only vertices of this leaf.
        if not self.unread.issubset(registers):
            raise Stopped("a leaf does not read what was loaded for it")
        self.unread.clear()
        corners = [self.v[register] for register in registers]
        points = [self.vertices[self.vertex_base + number] for number in corners]
        lo, hi = [INF] * 3, [-INF] * 3
        for point in points:
            lo = [x if x < bound else bound for x, bound in zip(point, lo)]
            hi = [x if x > bound else bound for x, bound in zip(point, hi)]
        if self.free:
            target = self.free.pop()
        else:
            target, self.fresh = self.fresh, self.fresh + 1
        if target >= self.box_registers:
            raise Stopped("box register %d" % target)
        self.triangles.append(corners)
        self.boxes[target] = (tuple(lo), tuple(hi)), ("leaf", self.leaves), self.instructions
        self.leaves += 1

    def _operand(self, register):
        if register not in self.boxes:
            raise Stopped("box register %d holds nothing" % register)
        box, what, written = self.boxes[register]
        if self.instructions - written < self.distance:
            raise Stopped("box register %d is read %d after it was written" % (register, self.instructions - written))
        return box, what

    def _node(self, left_axis, right_axis, a, b):
        if left_axis == 3 or right_axis == 3 or a == b:
            raise Stopped("no instruction: node")
        (left, left_what), (right, right_what) = self._operand(a), self._operand(b)
        own = self.node_base + self.nodes
        self.nodes += 1
        bounds = (left[0][left_axis], left[1][left_axis], right[0][right_axis], right[1][right_axis])
        self.writes.append((own, bounds))
        self.links.append((left_what, right_what, left_axis, right_axis))
        lo = [x if x < bound else bound for bound, x in zip(left[0], right[0])]
        hi = [x if x > bound else bound for bound, x in zip(left[1], right[1])]
        self.boxes[a] = (tuple(lo), tuple(hi)), ("node", own), self.instructions
        del self.boxes[b]
        self.free.append(b)


class Update:
    """update_*.hex."""

    def __init__(self, checker, scene):
        self.checker, self.scene = checker, scene
        self.numbers, self.report = checker.numbers, checker.report
        self.layouts, self.lines = checker.layouts, checker.lines
        vertex = self.layouts["update_vertices"]
        self.vertices = [
            tuple(self.numbers.decode(vertex.get(line, axis)) for axis in AXES) for line in self.lines["update_vertices.hex"]
        ]
        low = b"".join(line.to_bytes(16, "little") for line in self.lines["update_program.hex"])
        self.program = low
        value = checker.folder.value
        self.distance = value("update_machine.merge_distance")
        self.registers = value("update_machine.vertex_registers"), value("update_machine.box_registers")

    def check(self):
        layout = self.layouts["update_commands"]
        commands = [{name: layout.get(line, name) for name, _, _, _ in layout.fields} for line in self.lines["update_commands.hex"]]
        after = list(self.lines["update_nodes_before.hex"])
        self._check_places(commands)
        runs = []
        for k in range(len(commands)):
            run = self._run(k, commands[k])
            runs.append(run)
            if run is not None:
                self._check_links(k, run)
                self._check_records(run)
                self._apply(run, after)
        chosen = set(self.checker.sample(len(commands)))
        for k, run in enumerate(runs):
            if run is not None and k in chosen:
                self._check_run(k, commands[k], run)
        self._check_after(after)
        self._check_directed(runs)
        self._check_objects(runs)
        self._check_canonical()

    def _check_directed(self, runs):
        """Checks that the bounds of directed objects are NaN before their update."""
        file, layout = "update_nodes_before.hex", self.layouts["update_nodes_before"]
        first, count = self.checker.part("update_commands.hex", "directed objects")
        bounds = layout.pack(**dict.fromkeys(("left_lo", "left_hi", "right_lo", "right_hi"), self.numbers.nan))
        upper = layout.at["link"][0]
        for run in runs[first : first + count]:
            if run is None:
                continue
            for own in range(run.node_base, min(run.node_base + run.nodes, len(self.lines[file]))):
                line = self.lines[file][own]
                self.checker.same("update_nodes_before", file, own, layout, line >> upper << upper | bounds, line)

    def _run(self, k, command):
        rows = self.program[16 * command["program"] : 16 * (command["program"] + command["rows"])]
        run = Program(rows, self.vertices, command["vertex_base"], command["node_base"], self.registers, self.distance)
        try:
            run.run()
        except Stopped as stopped:
            row = command["program"] + 1
            self.report.count("update_program")
            self.report.wrong("update_program", "update_program.hex", row, "update %d" % k, "a valid program", str(stopped))
            return None
        expect = self.report.expect
        expect("update_program", "update_program.hex", command["program"] + 1, "nodes of update %d" % k, run.leaves - 1, run.nodes)
        root = ("node", command["node_base"] + run.nodes - 1) if run.nodes else ("leaf", 0)
        expect("update_program", "update_program.hex", command["program"] + 1, "end of update %d" % k, root, run.of_end)
        expect("update_commands", "update_commands.hex", k + 1, "writes", run.nodes, command["writes"])
        expect("update_commands", "update_commands.hex", k + 1, "instructions", run.instructions, command["instructions"])
        return run

    def _check_places(self, commands):
        """Checks that objects are consecutive, each after one or two fillers."""
        report, file = self.report, "update_commands.hex"
        ends = {"program": 0, "node_base": 0}
        files = {"program": ["update_program.hex"], "node_base": ["update_nodes_before.hex", "update_nodes_after.hex", "update_records.hex"]}
        first_write = 0
        filler = self.checker.check_filler
        for k, command in enumerate(commands):
            report.expect("update_commands", file, k + 1, "first_write", first_write, command["first_write"])
            first_write += command["writes"]
            for field, size in (("program", command["rows"]), ("node_base", command["writes"] + 1)):
                good = ends[field] + 1 <= command[field] <= ends[field] + 2
                words = "%d or %d" % (ends[field] + 1, ends[field] + 2)
                report.claim("update_commands", file, k + 1, field, good, words, command[field])
                for name in files[field]:
                    filler("update fillers", name, ends[field], command[field])
                ends[field] = command[field] + size
            following = commands[k + 1]["vertex_base"] if k + 1 < len(commands) else len(self.vertices)
            good = 0 < command["vertex_base"] < following - 1
            report.claim("update_commands", file, k + 1, "vertex_base", good, "below %d" % (following - 1), command["vertex_base"])
            filler("update fillers", "update_vertices.hex", max(0, command["vertex_base"] - 1), command["vertex_base"])
        filler("update fillers", "update_vertices.hex", len(self.vertices) - 1, len(self.vertices))
        for field, names in files.items():
            for name in names:
                count = len(self.lines[name])
                words = "%d or %d" % (ends[field] + 1, ends[field] + 2)
                report.claim("update_commands", name, None, "lines", ends[field] + 1 <= count <= ends[field] + 2, words, count)
                filler("update fillers", name, ends[field], count)
        indices = sorted(command["box_index"] for command in commands)
        report.expect("update_commands", file, None, "box_index", list(range(len(commands))), indices)
        report.expect("update_commands", "update_boxes.hex", None, "lines", len(commands), len(self.lines["update_boxes.hex"]))
        report.expect("update_commands", "update_node_writes.hex", None, "lines", first_write, len(self.lines["update_node_writes.hex"]))

    def _check_run(self, k, command, run):
        checker, encode = self.checker, self.numbers.encode
        layout = self.layouts["update_node_writes"]
        for place, (node, bounds) in enumerate(run.writes):
            values = dict(zip(("left_lo", "left_hi", "right_lo", "right_hi"), map(encode, bounds)))
            expected = layout.pack(node=node, mask=15, **values)
            at = command["first_write"] + place
            found = checker.line("update_node_writes", "update_node_writes.hex", at, "none")
            if found is None:
                break
            checker.same("update_node_writes", "update_node_writes.hex", at, layout, expected, found)
        layout = self.layouts["update_boxes"]
        expected = layout.put_vector("lo", map(encode, run.box[0])) | layout.put_vector("hi", map(encode, run.box[1]))
        found = checker.line("update_boxes", "update_boxes.hex", command["box_index"], "none")
        if found is not None:
            checker.same("update_boxes", "update_boxes.hex", command["box_index"], layout, expected, found)

    def _check_links(self, k, run):
        """Checks the object's link words in memory against its program; its last slot is 0."""
        layout, lines = self.layouts["update_nodes_before"], self.lines["update_nodes_before.hex"]
        kind, file = "update_nodes_before", "update_nodes_before.hex"
        report = self.report
        base, count = run.node_base, run.nodes
        if base + count >= len(lines):
            report.wrong(kind, file, len(lines), "line", "a line", "none")
            return
        right_leaves = collections.Counter()
        upper = layout.at["link"][0]
        for place, (left, right, left_axis, right_axis) in enumerate(run.links):
            own = base + place
            word = link_fields(lines[own] >> upper)
            flags = left[0] == "leaf", right[0] == "leaf"
            expect = report.expect
            expect(kind, file, own + 1, "left_leaf", int(flags[0]), word["left_leaf"])
            expect(kind, file, own + 1, "right_leaf", int(flags[1]), word["right_leaf"])
            expect(kind, file, own + 1, "axes", (left_axis, right_axis), (word["left_axis"], word["right_axis"]))
            if flags == (True, True):
                right_leaves[word["link"]] += 1
                good = base <= word["link"] <= base + count
                report.claim(kind, file, own + 1, "link", good, "a record of the object", word["link"])
                continue
            inner = right[1] if flags[0] else left[1]
            expect(kind, file, own + 1, "link", inner, word["link"])
            if flags == (False, False):
                report.claim(kind, file, own + 1, "link", right[1] == left[1] + 1, "two inner children side by side", (left[1], right[1]))
            else:
                continue
        both_inner = [base + place for place, (l, r, _, _) in enumerate(run.links) if l[0] == r[0] == "node"]
        if count:
            report.expect(kind, file, base + count, "right leaves", sorted(both_inner + [base + count]), sorted(right_leaves.elements()))
        report.expect(kind, file, base + count + 1, "unused slot", 0, lines[base + count])

    def record(self, index):
        line = self.lines["update_records.hex"][index] if index < len(self.lines["update_records.hex"]) else 0
        return tuple(line >> 32 * k & ALL_ONES for k in range(4))

    def _check_records(self, run):
        """Checks that each leaf of the program has the vertices of its record, and that the records number the object's triangles."""
        report, kind, file = self.report, "update_records", "update_records.hex"
        layout, nodes = self.layouts["update_nodes_before"], self.lines["update_nodes_before.hex"]
        base, count = run.node_base, run.nodes + 1
        if base + count > len(nodes):
            return
        places = {0: base} if run.nodes == 0 else {}
        for place, (left, right, _, _) in enumerate(run.links):
            own, link = base + place, link_fields(nodes[base + place] >> layout.at["link"][0])["link"]
            if left[0] == "leaf":
                places[left[1]] = own
            if right[0] == "leaf":
                places[right[1]] = link if left[0] == "leaf" else own
        run.places = places
        for number, index in places.items():
            expected = sorted(run.vertex_base + vertex for vertex in run.triangles[number])
            report.expect(kind, file, index + 1, "vertices", expected, sorted(self.record(index)[:3]))
        numbers = sorted(self.record(index)[3] for index in range(base, base + count))
        report.expect(kind, file, base + 1, "numbers of an object", list(range(count)), numbers)

    def _apply(self, run, after):
        layout, encode = self.layouts["update_nodes_after"], self.numbers.encode
        upper = layout.at["link"][0]
        for node, bounds in run.writes:
            if node < len(after):
                values = dict(zip(("left_lo", "left_hi", "right_lo", "right_hi"), map(encode, bounds)))
                after[node] = after[node] >> upper << upper | layout.pack(**values)

    def _check_after(self, after):
        checker = self.checker
        lines = self.lines["update_nodes_after.hex"]
        self.report.expect("update_nodes_after", "update_nodes_after.hex", None, "lines", len(after), len(lines))
        layout = self.layouts["update_nodes_after"]
        for place in checker.sample(min(len(after), len(lines))):
            checker.same("update_nodes_after", "update_nodes_after.hex", place, layout, after[place], lines[place])

    def _check_objects(self, runs):
        """Checks that the first updates are those of the objects of scene 0, those with a node as root first."""
        first, count = self.checker.part("update_commands.hex", "objects of the scene")
        blocks = sorted(self.scene.blocks, key=lambda block: (block.root["left_leaf"], block.root["link"]))
        field = "parts: objects of the scene"
        self.report.expect("update of the scene", "update_commands.hex", None, field, (0, len(blocks)), (first, count))
        for k, (run, block) in enumerate(zip(runs, blocks)):
            if run is None:
                continue
            if self.report.expect("update of the scene", "update_commands.hex", k + 1, "triangles", block.slots, run.leaves):
                self._check_object(run, block)

    def _check_object(self, run, block):
        """Checks that an object's tree in the update processor's memory is that in nodes.hex, and its triangles are those of the records."""
        scene, report = self.scene, self.report
        pairs = {}

        def leaf(index, number):
            ours, theirs = scene.records[index], self.record(run.places.get(number, 0))
            for vertex, moved in zip(ours[:3], theirs[:3]):
                if pairs.setdefault(vertex, moved) != moved:
                    words = "vertex %d, as in another record" % pairs[vertex]
                    report.wrong("update of the scene", "update_records.hex", run.places.get(number, 0) + 1, "vertex", words, moved)

        if block.root["left_leaf"]:
            leaf(block.root["link"], 0)
        stack = [(block.root["link"], run.node_base + run.nodes - 1)] if run.nodes else []
        while stack:
            index, own = stack.pop()
            node = scene.nodes[index]
            self._check_bounds(node, own)
            what = run.links[own - run.node_base]
            flags = bool(node.left_leaf), bool(node.right_leaf)
            same = (what[0][0] == "leaf", what[1][0] == "leaf", what[2], what[3]) == flags + (node.left_axis, node.right_axis)
            words = "the tree of nodes.hex"
            if not report.claim("update of the scene", "update_nodes_before.hex", own + 1, "link word", same, words, what):
                return
            for (child, is_leaf), (_, number) in zip(children_of(index, node), what):
                if is_leaf:
                    leaf(child, number)
                else:
                    stack.append((child, number))
        self._check_vertices(block, pairs)

    def _check_bounds(self, node, own):
        lines, layout = self.lines["update_nodes_before.hex"], self.layouts["update_nodes_before"]
        if own < len(lines):
            upper = layout.at["link"][0]
            expected = lines[own] >> upper << upper | node.line & (1 << upper) - 1
            self.checker.same("update of the scene", "update_nodes_before.hex", own, layout, expected, lines[own])

    def _check_vertices(self, block, pairs):
        """Checks that vertices have moved by at most 1/64 of the box, rounded once, and that no two of them share one line."""
        report, rounded = self.report, self.numbers.round
        lo, hi = block.box
        most = max(b - a for a, b in zip(lo, hi)) / 64.0
        report.expect("update of the scene", "update_records.hex", None, "vertices", len(pairs), len(set(pairs.values())))
        words = "moved by at most %.9g" % most
        for ours, theirs in pairs.items():
            if theirs < len(self.vertices):
                old, new = self.scene.vertices[ours], self.vertices[theirs]
                good = all(rounded(a - most) <= b <= rounded(a + most) for a, b in zip(old, new))
                report.claim("update of the scene", "update_vertices.hex", theirs + 1, "vertex", good, words, "%s from %s" % (new, old))

    def _check_canonical(self):
        """Checks that numbers are canonical and not -0, in fillers as well."""
        for file, layout in (
            ("update_vertices.hex", "update_vertices"),
            ("update_nodes_before.hex", "update_nodes_before"),
            ("update_nodes_after.hex", "update_nodes_after"),
            ("update_boxes.hex", "update_boxes"),
        ):
            self.checker.check_canonical(file, layout)


# ---- Skinning ------------------------------------------------------------------------------------------------------


class Skinning:
    """skinning_*.hex."""

    def __init__(self, checker, scene):
        self.checker, self.scene = checker, scene
        self.numbers, self.report = checker.numbers, checker.report
        self.layouts, self.lines = checker.layouts, checker.lines
        vertex, decode = self.layouts["skinning_vectors"], self.numbers.decode
        self.vectors = [tuple(decode(vertex.get(line, axis)) for axis in AXES) for line in self.lines["skinning_vectors.hex"]]

    def check(self):
        layout = self.layouts["skinning_commands"]
        report, file = self.report, "skinning_commands.hex"
        commands = [{name: layout.get(line, name) for name, _, _, _ in layout.fields} for line in self.lines[file]]
        first, vectors, rows = 0, 0, 0
        for k, command in enumerate(commands):
            # One filler precedes each mesh; palette, rest and target are consecutive.
            palette = vectors + 1
            rest = palette + 4 * command["joints"]
            target = rest + command["vertices"]
            vectors = target + command["vertices"]
            influence_rows = (command["count"] + 3) // 4
            self.checker.check_filler("skinning fillers", "skinning_vectors.hex", palette - 1, palette)
            self.checker.check_filler("skinning fillers", "skinning_influences.hex", rows, rows + 1)
            for field, value in (
                ("palette", palette),
                ("rest", rest),
                ("target", target),
                ("influences", rows + 1),
                ("rows", influence_rows),
                ("first_vertex", first),
            ):
                report.expect("skinning_commands", file, k + 1, field, value, command[field])
            first += command["vertices"]
            rows += 1 + influence_rows
        for name, count in (
            ("skinning_expected.hex", first),
            ("skinning_vectors.hex", vectors),
            ("skinning_influences.hex", rows),
        ):
            report.expect("skinning_commands", name, None, "lines", count, len(self.lines[name]))
        for k in self.checker.sample(len(commands)):
            self._check_mesh(k, commands[k])
        self._check_unused_joints(commands)
        self._check_objects(commands)
        for name in ("skinning_vectors", "skinning_influences", "skinning_expected"):
            self.checker.check_canonical(name + ".hex", name)

    def _check_unused_joints(self, commands):
        """Checks that in directed meshes the matrices that no influence names are NaN."""
        first, count = self.checker.part("skinning_commands.hex", "directed meshes")
        for command in commands[first : first + count]:
            stream = self._influences(None, command)
            if stream is None:
                continue
            named = {joint for _, joint, _ in stream}
            for joint in range(command["joints"]):
                if joint not in named:
                    at = command["palette"] + 4 * joint
                    self.checker.check_filler("skinning fillers", "skinning_vectors.hex", at, at + 4)

    def _check_objects(self, commands):
        """Checks that the vertices of the scene's skinned objects are consecutive lines of vertices.hex."""
        first, count = self.checker.part("skinning_commands.hex", "skinned objects of the scene")
        layout = self.layouts["skinning_expected"]
        scene, start = self.scene, self.scene.first_vertex
        width = layout.width - layout.at["x"][0]
        images = self.lines["vertices.hex"]
        for k in range(first, min(first + count, len(commands))):
            command = commands[k]
            lines = self.lines["skinning_expected.hex"][command["first_vertex"] :][: command["vertices"]]
            wanted = [line >> layout.at["x"][0] & (1 << width) - 1 for line in lines]
            places = range(start, scene.end_vertex - len(wanted) + 1)
            # Take the position at which most vertices agree, so a single wrong vertex is reported as one mismatch.
            best = max(places, key=lambda at: sum(a == b for a, b in zip(wanted, images[at : at + 8])), default=None)
            if best is None:
                self.report.wrong("skinning of the scene", "vertices.hex", None, "mesh %d" % k, "its vertices", "none")
                continue
            for at, value in enumerate(wanted):
                self.checker.same("skinning of the scene", "vertices.hex", best + at, self.layouts["vertices"], value, images[best + at])
            start = best + len(wanted)

    def _influences(self, k, command):
        """The influences of a mesh as a list of (weight, joint, last)."""
        layout, decode = self.layouts["skinning_influences"], self.numbers.decode
        stream = []
        lines = self.lines["skinning_influences.hex"]
        for row in range(command["influences"], command["influences"] + command["rows"]):
            line = self.checker.line("skinning_influences", "skinning_influences.hex", row, "none")
            if line is None:
                return None
            for slot in range(4):
                values = [layout.get(line, "%s%d" % (name, slot)) for name in ("weight", "joint", "last")]
                if len(stream) < command["count"]:
                    stream.append((decode(values[0]), values[1], values[2]))
                    good = values[1] < command["joints"]
                    words = "a joint below %d" % command["joints"]
                    self.report.claim("skinning_influences", "skinning_influences.hex", row + 1, "joint%d" % slot, good, words, values[1])
                    if not good:
                        return None
                else:
                    self.report.expect("skinning_influences", "skinning_influences.hex", row + 1, "unused slot %d" % slot, [0, 0, 0], values)
        return stream

    def _check_mesh(self, k, command):
        checker, report, encode = self.checker, self.report, self.numbers.encode
        stream = self._influences(k, command)
        if stream is None:
            return
        layout = self.layouts["skinning_expected"]
        place = 0
        ends = [command["rest"], command["target"]]
        need = max(end + command["vertices"] for end in ends), command["palette"] + 4 * command["joints"]
        good = max(need) <= len(self.vectors)
        report.claim("skinning_commands", "skinning_commands.hex", k + 1, "places", good, "in skinning_vectors.hex", max(need))
        if not good:
            return
        for vertex in range(command["vertices"]):
            influences = []
            while True:
                if place >= len(stream) or len(influences) == 4:
                    report.wrong("skinning_influences", "skinning_influences.hex", command["influences"] + place // 4 + 1, "last", "1 to 4 influences a vertex", "more")
                    return
                weight, joint, last = stream[place]
                place += 1
                at = command["palette"] + 4 * joint
                influences.append((self.vectors[at : at + 4], weight))
                if last:
                    break
            moved = checker.units.skin(self.vectors[command["rest"] + vertex], influences)
            expected = layout.pack(vertex=command["target"] + vertex, **dict(zip(AXES, map(encode, moved))))
            at = command["first_vertex"] + vertex
            found = checker.line("skinning_expected", "skinning_expected.hex", at, "none")
            if found is None:
                return
            checker.same("skinning_expected", "skinning_expected.hex", at, layout, expected, found)
            target = self.lines["skinning_vectors.hex"][command["target"] + vertex]
            report.expect("skinning_vectors", "skinning_vectors.hex", command["target"] + vertex + 1, "target", 0, target)
        report.expect("skinning_commands", "skinning_commands.hex", k + 1, "count", place, command["count"])


# ---- All of it -----------------------------------------------------------------------------------------------------


class Work:
    """The checks that can run in several processes: packets, rays by brute force, lines of units."""

    def __init__(self, casting, unit_lines):
        self.casting, self.unit_lines = casting, unit_lines

    def do(self, task):
        what, places = task
        if what == "packets":
            for p in places:
                self.casting.check_packet(p)
        elif what == "brute force":
            for k in places:
                self.casting.check_brute_force(k)
        else:
            for place in places:
                self.unit_lines.check(what, place)

    def tasks(self, pieces):
        checker = self.casting.checker
        lines = checker.lines
        whole = [("packets", checker.sample(len(lines["raycast_packets.hex"])))]
        whole.append(("brute force", self.casting.brute_force_rays()))
        for unit, _ in UNITS:
            if unit + "_stimulus.hex" in lines:
                whole.append((unit, checker.sample(len(lines[unit + "_stimulus.hex"]))))
        return [(what, places[k::pieces]) for what, places in whole for k in range(pieces) if places[k::pieces]]


WORK = None


def do_task(task):
    """Runs in a worker process, which has a copy of all files."""
    report = Report()
    WORK.casting.checker.report = report
    WORK.do(task)
    return report.kinds


def check(path, limit, jobs):
    """Checks a folder and returns the report."""
    global WORK
    report = Report()
    folder = Folder(path, report)
    folder.read()
    checker = Checker(folder, report, limit, jobs)
    checker.check_manifest()
    checker.check_macros()
    memory = Memory(checker)
    scenes = [Scene(checker, memory, number) for number in range(len(folder.scenes))]
    for scene in scenes:
        scene.check()
    for name in ("nodes", "vertices", "scene"):
        checker.check_canonical(name + ".hex", name)
    casting = RayCasting(checker, scenes)
    casting.check_serial()
    unit_lines = UnitLines(checker, scenes[0])
    unit_lines.check_counts()
    unit_lines.check_special_operands()
    Update(checker, scenes[0]).check()
    Skinning(checker, scenes[0]).check()
    WORK = Work(casting, unit_lines)
    if jobs > 1 and "fork" in multiprocessing.get_all_start_methods():
        with multiprocessing.get_context("fork").Pool(jobs) as pool:
            for kinds in pool.imap(do_task, WORK.tasks(4 * jobs)):
                report.add(kinds)
    else:
        for task in WORK.tasks(1):
            WORK.do(task)
    return report


def table(report):
    rows = [("kind", "checked", "mismatches")]
    rows += [(kind, "{:,}".format(checked), "{:,}".format(wrong)) for kind, (checked, wrong, _) in report.kinds.items()]
    widths = [max(len(row[k]) for row in rows) for k in range(3)]
    return ["%-*s  %*s  %*s" % (widths[0], row[0], widths[1], row[1], widths[2], row[2]) for row in rows]


def first_mismatch(kind, first):
    place = first["file"] or "the folder"
    if first["line"] is not None:
        place += " line %d" % first["line"]
    return "%s: %s: %s: expected %s, found %s" % (kind, place, first["field"], first["expected"], first["found"])


def main(arguments):
    parser = argparse.ArgumentParser(
        prog="check_vectors.py",
        description="Checks a folder that `dynrt vectors` wrote: recomputes its contents from the definitions in docs/vectors.md.",
        epilog="Exit status 0 if something was checked and all of it is right, 1 if not, 2 for arguments that make no sense.",
    )
    parser.add_argument("folder", metavar="DIR", help="the folder of vectors")
    parser.add_argument("--limit", metavar="N", type=positive, help="check at most N packets, N lines of each unit, N updates, N meshes, spread evenly; files, layouts and trees are always checked completely")
    parser.add_argument("--jobs", metavar="N", type=positive, default=os.cpu_count() or 1, help="number of processes [default: one per core]")
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON; with - to the standard output, and the table to the standard error")
    parser.add_argument("--quiet", action="store_true", help="print nothing if there is no mismatch, else only the first mismatch of each kind")
    options = parser.parse_args(arguments)
    try:
        report = check(options.folder, options.limit, options.jobs)
    except Refused as refused:
        print("error: %s" % refused, file=sys.stderr)
        return 1
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        # The checks above do not cover every way in which a manifest can be malformed.
        what = "%s: %s" % (type(error).__name__, error)
        print("error: %s: is not as docs/vectors.md says, so that it cannot be checked: %s" % (options.folder, what), file=sys.stderr)
        return 1
    checked = sum(row[0] for row in report.kinds.values())
    wrong = sum(row[1] for row in report.kinds.values())
    right = checked > 0 and wrong == 0
    if options.json:
        write_json(options, report, checked, wrong)
    # If JSON goes to the standard output, nothing else does.
    out = sys.stderr if options.json == "-" else sys.stdout
    if not options.quiet:
        print("\n".join(table(report)), file=out)
    for kind, (_, _, first) in report.kinds.items():
        if first:
            print(first_mismatch(kind, first), file=out)
    if not options.quiet or not right:
        verdict = "right" if right else "WRONG"
        words = options.folder, verdict, "{:,}".format(checked), "{:,}".format(wrong)
        print("%s: %s: %s values checked, %s mismatches" % words, file=out)
    return 0 if right else 1


def positive(text):
    number = int(text)
    if number < 1:
        raise ValueError(text)
    return number


def write_json(options, report, checked, wrong):
    kinds = {kind: {"checked": row[0], "mismatches": row[1], "first": row[2]} for kind, row in report.kinds.items()}
    document = {"folder": options.folder, "checked": checked, "mismatches": wrong, "kinds": kinds}
    text = json.dumps(document, indent=2) + "\n"
    if options.json == "-":
        sys.stdout.write(text)
        return
    with open(options.json, "w", encoding="utf-8") as file:
        file.write(text)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
