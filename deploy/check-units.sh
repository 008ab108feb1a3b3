#!/bin/sh
# Checks the units: systemd finds nothing wrong with them, and the walls around the services are high.
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

check() {  # systemd says what is wrong and succeeds
    told=$(systemd-analyze verify "$@" 2>&1) && [ -z "$told" ] || { echo "$told"; exit 1; }
}
check --man=no "$folder"/*.service
check --man=no --user "$folder"/user/*.service

# Exposure of 1.2 at most, as redis has; a unit with nothing but User= has 9.2.
for unit in *.service; do
    systemd-analyze security --offline=true --threshold=12 "$folder/$unit" > "$folder/told" || { cat "$folder/told"; exit 1; }
    tail -n 1 "$folder/told"
done
