#!/bin/bash
# Runs or resumes a campaign: builds the programs, runs the jobs that are not done, and writes the report.
#
#     sim/campaign/run.sh [--configfile F] [--no-cargo] [--report] [OPTIONS OF SNAKEMAKE]
#
#     --configfile F  the campaign's configuration; sim/campaign/config.yaml by default
#     --no-cargo      uses the existing target/release/dynrt and builds nothing; tests and benches are left out
#     --report        only writes the report
#
# Other options are passed to Snakemake, such as --profile sim/campaign/profiles/local, --cores 2, --dry-run. Exit status: 0 if every job is
# done and all required figures are reached, 1 if not, 2 if another campaign is running in the same folder.
set -u -o pipefail

# Bash reads the whole file before it runs any of it, because the file may change during a long campaign.
main() {
    local here root config only_report options python folder snakemake profile option ended
    here=$(cd "$(dirname "$0")" && pwd) || exit 1
    root=$(cd "$here/../.." && pwd) || exit 1
    config=$here/config.yaml only_report= options=()
    export DYNRT_CAMPAIGN_BUILD=
    while [ $# -gt 0 ]; do
        case $1 in
            --configfile) config=$(realpath -e -- "${2:?--configfile needs a file}") || exit 1; shift ;;
            --profile)
                profile=${2:?--profile needs a folder}
                # A path relative to this folder, or else a name that Snakemake knows.
                [ ! -d "$profile" ] || profile=$(realpath -- "$profile")
                options+=(--profile "$profile")
                shift
                ;;
            --no-cargo) DYNRT_CAMPAIGN_BUILD=--no-cargo ;;
            --report) only_report=1 ;;
            --help | -h) sed -n '2,11p' "$0" | sed 's/^# \{0,1\}//'; exit 0 ;;
            *) options+=("$1") ;;
        esac
        shift
    done

    export DYNRT_TOOLS=${DYNRT_TOOLS:-$root/target/tools/bin}
    PATH=$DYNRT_TOOLS:$root/target/tools/bin:$PATH
    snakemake=$(command -v snakemake) || { echo "error: snakemake is not there; make evidence installs it into target/tools" >&2; exit 1; }
    # The Python interpreter of Snakemake has the YAML library that jobs.py needs.
    python=$(sed -n '1s/^#!//p' "$snakemake")

    report() { $python "$here/report.py" "$config"; }
    [ -z "$only_report" ] || { report; exit; }

    folder=$($python "$here/report.py" --folder "$config") && mkdir -p "$folder" || exit 1
    # Snakemake's own lock survives if a campaign is killed; this lock is released when its last process ends.
    exec 9>"$folder/lock"
    flock -w 30 9 || { echo "error: another campaign is running in $folder" >&2; exit 2; }
    # Snakemake stores the state of jobs in the current directory.
    cd "$folder" || exit 1
    campaign() { "$snakemake" --snakefile "$here/Snakefile" --configfile "$config" --nolock "$@"; }

    # An earlier build may not match the current configuration.
    rm -f bin/built.json
    campaign --quiet all --cores 1 build || { echo "error: what the jobs run could not be built" >&2; exit 1; }
    campaign "${options[@]}"
    ended=$?
    for option in "${options[@]}"; do
        case $option in --dry-run | --dryrun | -n) exit "$ended" ;; esac
    done
    report || exit 1
    exit "$ended"
}

main "$@"
