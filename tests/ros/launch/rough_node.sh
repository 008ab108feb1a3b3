#!/bin/sh
# A node of a launch file that goes wrong in some way: $1 is how, $2 the folder of the logs, $3 the robots, $4 the seed.
how=$1 logs=$2 robots=$3 seed=$4
log() { printf '# step\tdistance\n0\t2.0\n1\t%s.5\n' "$2" > "$logs/robot_$1.log"; }
mkdir -p "$logs"
case $how in
    fine) ;;
    stays-behind) setsid sh -c 'trap "" INT TERM HUP; exec sleep 1000' & ;;
    one-log-less) robots=$((robots - 1)) ;;
    no-logs) exit 0 ;;
    malformed) echo "nonsense" > "$logs/robot_0.log" ; exit 0 ;;
    fails) log 0 1; echo "cannot load the map" >&2; exit 7 ;;
    is-killed) log 0 1; kill -KILL $$ ;;
    kills-roslaunch) for robot in $(seq "$robots"); do log "$robot" 1; done; kill -KILL $PPID; sleep 1000 ;;
    ends-roslaunch) for robot in $(seq "$robots"); do log "$robot" 1; done; kill -TERM $PPID; sleep 1000 ;;
    hangs) touch "$logs/hangs"; exec sleep 1000 ;;
esac
for robot in $(seq "$robots"); do log "$robot" "$seed"; done
