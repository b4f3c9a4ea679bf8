#!/bin/sh
# What the guest does: native robots on vcan0, and everybody talks to them through it; then an
# emulated robot at a cable of its own. Arguments: the simulator, the master, the root of the
# workspace, the release image. Any command that fails ends it; what was said until then is on the
# console.
set -eu
sim=$1 omnibus=$2 root=$3 elf=$4
cd /mnt
group=$root/groups/tcc-2.toml
# A guest that waits for a file of the host's skips time, and robots would miss what was due in it:
# what is needed is read beforehand.
cat "$sim" "$omnibus" "$elf" >/dev/null

# What was said last, when something fails.
at_exit() {
    code=$?
    if [ $code -ne 0 ]; then
        for file in sim.out sim.log can.log robot.out robot.log; do
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

# Brings an interface up that slcand is about to name. /sys has the new name before the kernel finds
# the interface by it, so only the command itself shows that the interface is there.
bring_up() {
    for _ in $(seq 100); do
        if busybox ip link set "$1" up 2>/dev/null; then return; fi
        sleep 0.1
    done
    busybox ip link set "$1" up
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
bring_up slcan0
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

# The firmware's own slcan, and nothing of ours between it and can-utils.
say "slcand on the cable of an emulated robot"
"$sim" serve "$root/groups/single.toml" --backend emulator --elf "$elf" --cable /dev/omnibus-robot \
    >robot.out 2>&1 &
robot=$!
wait_for '^serving' robot.out
slcand -F -o -c -s8 /dev/omnibus-robot robot0 &
adapter=$!
bring_up robot0
candump -L robot0 >robot.log &
robot_logger=$!
wait_for ' 702#7F$' robot.log

# request NAME FRAME ANSWER: the robot answers an SDO as candump shows it.
request() {
    candump -n 1 -T 20000 robot0,582:7FF >answer &
    asker=$!
    sleep 0.3
    cansend robot0 "$2"
    wait $asker
    cat answer
    if ! grep -q "582   \[8\]  $3" answer; then
        echo "$1: not $3"
        return 1
    fi
}
# CiA 301: the product code in 0x1018:2; then heartbeat off and on (0x1017), which NMT reset
# communication restores.
request 'product code' 602#4018100200000000 '43 18 10 02 49 4E 4D 4F'
request 'heartbeat off' 602#2B17100000000000 '60 17 10 00 00 00 00 00'
cansend robot0 000#8202
wait_for ' 702#00$' robot.log
beats=$(grep -c ' 702#7F$' robot.log)
for _ in $(seq 300); do
    if [ "$(grep -c ' 702#7F$' robot.log)" -gt "$beats" ]; then break; fi
    sleep 0.1
done
test "$(grep -c ' 702#7F$' robot.log)" -gt "$beats"
# NMT start of a robot that has no parameters: emergency 0xFF17, and it does not start.
cansend robot0 000#0102
wait_for ' 082#17FF' robot.log
# What the cable has lost so far (0x2131:1): nothing.
request 'lost to the cable' 602#4031210100000000 '43 31 21 01 00 00 00 00'
kill $robot_logger
kill $adapter
wait $adapter || true
kill -INT $robot
wait $robot

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
