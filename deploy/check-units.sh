#!/bin/sh
# Checks that systemd accepts the units, and that the services are sandboxed.
# check-units.sh BIN: a folder with the programs zswarm-ss and zswarm-router
set -eu
bin=$(cd "$1" && pwd)
cd "$(dirname "$0")/systemd"
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
mkdir "$folder/user"
export XDG_RUNTIME_DIR="$folder"
for unit in *.service user/*.service; do
    sed "s,/opt/zswarm/bin,$bin,; s,%h/.local/lib/zswarm/bin,$bin," "$unit" > "$folder/$unit"
done

check() {  # systemd prints errors but succeeds
    errors=$(systemd-analyze verify "$@" 2>&1) && [ -z "$errors" ] || { echo "$errors"; exit 1; }
}
check --man=no "$folder"/*.service
check --man=no --user "$folder"/user/*.service

# Exposure of at most 1.2, like redis; a unit with only User= has 9.2.
for unit in *.service; do
    systemd-analyze security --offline=true --threshold=12 "$folder/$unit" > "$folder/report" || { cat "$folder/report"; exit 1; }
    tail -n 1 "$folder/report"
done
