#!/bin/sh
# What the guest does: native robots on vcan0, and everybody talks to them through it. Arguments:
# the simulator, the master, the root of the workspace. Any command that fails ends it; what was
# said until then is on the console.
set -eu
sim=$1 omnibus=$2 root=$3
cd /mnt
group=$root/groups/tcc-2.toml
# Reading a file from the host takes real time, which the guest's clock counts: what is needed is
# read beforehand.
cat "$sim" "$omnibus" >/dev/null

# What was said last, when something fails.
at_exit() {
    code=$?
    if [ $code -ne 0 ]; then
        for file in sim.out sim.log can.log; do
            echo "-- the end of $file:"
            tail -n 25 "$file"
        done
    fi
    exit $code
}
trap at_exit EXIT

say() { printf '\n== %s (%.0f s since power-on)\n' "$*" "$(cut -d' ' -f1 /proc/uptime)"; }

# Waits until a file has a line that matches.
wait_for() {
    for _ in $(seq 300); do
        if grep -q "$1" "$2" 2>/dev/null; then return; fi
        sleep 0.1
    done
    echo "no '$1' in $2:"
    cat "$2"
    return 1
}

say "omnibus-sim serve --socketcan vcan0 --pty /dev/omnibus-can"
"$sim" serve "$group" --socketcan vcan0 --pty /dev/omnibus-can --log sim.log >sim.out 2>&1 &
simulator=$!
wait_for '^serving' sim.out
grep '^socketcan vcan0$' sim.out
candump -L vcan0 >can.log &
logger=$!

say "can-utils: a heartbeat comes, an SDO is answered, NMT is obeyed"
candump -n 1 vcan0,702:7FF
candump -n 1 -T 20000 vcan0,582:7FF >answer &
asker=$!
sleep 0.3
# Object 0x1000: the device type, 0, as every device without a profile says.
cansend vcan0 602#4000100000000000
wait $asker
cat answer
grep -q '582   \[8\]  43 00 10 00 00 00 00 00' answer
cansend vcan0 000#8103
wait_for ' 703#00$' can.log

say "omnibus scan"
"$omnibus" scan --bus socketcan:vcan0 --group "$group" >scan.out
cat scan.out
grep -q ' 2 .* PRE-OP ' scan.out
grep -q ' 3 .* PRE-OP ' scan.out

say "omnibus drive"
"$omnibus" drive --bus socketcan:vcan0 --group "$group" --vx 0.2 --for 1

# The kernel's own slcan on the simulator's terminal: a second interface on the same bus.
say "slcand on the pseudo terminal"
slcand -F -o -c -s8 /dev/omnibus-can slcan0 &
adapter=$!
for _ in $(seq 100); do
    if [ -e /sys/class/net/slcan0 ]; then break; fi
    sleep 0.1
done
busybox ip link set slcan0 up
candump -n 1 -T 20000 slcan0,703:7FF
candump -n 1 -T 20000 slcan0,583:7FF >adapted &
asker=$!
sleep 0.3
cansend slcan0 603#4000100000000000
wait $asker
cat adapted
grep -q '583   \[8\]  43 00 10 00 00 00 00 00' adapted
# What one interface sends, the other hears.
wait_for ' 603#4000100000000000$' can.log
kill $adapter
wait $adapter || true

# The same terminal, opened by the master itself.
say "omnibus scan on the pseudo terminal"
"$omnibus" scan --bus slcan:/dev/omnibus-can --group "$group" >scan.out
grep ' 2 .* PRE-OP ' scan.out
grep ' 3 .* PRE-OP ' scan.out

say "the same frames on both sides"
# What is on its way to the logger arrives.
sleep 1
kill -INT $simulator
wait $simulator
kill $logger
for id in 080 181 182 183 282; do
    there=$(grep -c " $id#" can.log) here=$(grep -c " $id#" sim.log)
    echo "$id: $here on the simulated bus, $there on vcan0"
    # A hundred SYNCs in the second of the drive.
    test "$there" -eq "$here" && test "$there" -ge 100
done
