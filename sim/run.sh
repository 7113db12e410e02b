#!/bin/sh
# Replays golden vectors in the Verilog with Icarus Verilog alone.
#
#   sim/run.sh VECTORS RTL [BENCH...] [+PLUSARG...]
#
# VECTORS is a folder that `dynrt vectors` wrote. RTL is a folder that `dynrt generate` wrote for the same configuration; its module names
# may have any prefix. BENCH is one or more of fp, ray_setup, packet_step, triangle_test, raycast, update and skinning, by default all of
# them. Plusargs are passed to the benches; see sim/raycast_tb.v and sim/memory.v. The script prints one line per bench; the exit status is
# 0 only if every bench reports PASS.

sim=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd) || exit 2
usage() {
    echo "usage: $0 VECTORS RTL [fp|ray_setup|packet_step|triangle_test|raycast|update|skinning]... [+PLUSARG]..." >&2
    exit 2
}
fail() {
    echo "FAIL $*"
    exit 1
}

[ $# -ge 2 ] || usage
vectors=$1
rtl=$2
shift 2
benches=
plusargs=
for word in "$@"; do
    case $word in
        +*) plusargs="$plusargs $word" ;;
        fp | ray_setup | packet_step | triangle_test | raycast | update | skinning) benches="$benches $word" ;;
        *) usage ;;
    esac
done
: "${benches:=fp ray_setup packet_step triangle_test raycast update skinning}"

command -v iverilog >/dev/null || fail "iverilog is not installed: install the package iverilog"
[ -d "$vectors" ] || fail "$vectors is no folder"
[ -f "$vectors/vectors.vh" ] || fail "$vectors/vectors.vh is missing"
vectors=$(CDPATH='' cd -- "$vectors" && pwd) || exit 2
# The generated modules are in the folder itself or in its folder rtl.
prefix=
find_unit() {
    for unit in "$1"/*raycast_unit.v; do
        [ -f "$unit" ] || return 1
        [ -z "$prefix" ] || fail "$1 holds more than one machine: $unit and ${prefix}raycast_unit.v"
        prefix=${unit##*/}
        prefix=${prefix%raycast_unit.v}
    done
}
find_unit "$rtl" || { rtl=$rtl/rtl && find_unit "$rtl"; } || fail "$rtl/dynrt_raycast_unit.v is missing"
rtl=$(CDPATH='' cd -- "$rtl" && pwd) || exit 2
# The raycast bench compares the trace ports if the machine has them.
trace=
if grep -q trace_step_valid "$rtl/${prefix}raycast_unit.v"; then trace=-DDYNRT_TRACE; fi
if empty=$(grep -o '[A-Z0-9_]*_LINES 0$' "$vectors/vectors.vh"); then
    fail "$vectors/vectors.vh: nothing to check:" $empty
fi

work=$(mktemp -d) || exit 2
trap 'rm -rf "$work"' EXIT
trap 'exit 2' HUP INT TERM

status=0
for bench in $benches; do
    case $bench in
        raycast | update | skinning) beside=memory ;;
        *) beside=replay ;;
    esac
    # The benches use the default names of the modules.
    for file in "${bench}_tb" "$beside"; do
        sed "s/dynrt_/$prefix/g" "$sim/$file.v" >"$work/$file.v"
    done
    if ! iverilog -g2001 -Wall -Wno-timescale ${trace:+"$trace"} -I "$sim" -I "$vectors" -y "$rtl" -Y .v -s "${prefix}${bench}_tb" -o "$work/$bench" \
        "$work/${bench}_tb.v" "$work/$beside.v" >"$work/log" 2>&1; then
        cat "$work/log" >&2
        echo "$bench: FAIL does not compile"
        status=1
        continue
    fi
    # The benches open their vectors by relative file names.
    # shellcheck disable=SC2086
    (cd "$vectors" && vvp -n "$work/$bench" $plusargs) >"$work/out" 2>&1
    if verdict=$(grep -m 1 '^FAIL ' "$work/out"); then
        status=1
    elif ! verdict=$(grep -m 1 '^PASS [1-9]' "$work/out"); then
        cat "$work/out" >&2
        verdict="FAIL without a verdict"
        status=1
    fi
    echo "$bench: $verdict"
done
exit $status
