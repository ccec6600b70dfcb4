# Runs in the emulated machine, systemd being process 1: the package from its installation to its
# removal. Prints `ROW name|verdict|what was seen`. /mnt holds the package, /dev/vda is for data.
exec > /mnt/service.log 2>&1
DATA=/var/lib/calm-edge
UNIT=calm-edge.service
SECTORS=$(blockdev --getsz /dev/vda)

row() { echo "ROW $1|$2|$3"; }
judge() { if eval "$2"; then row "$1" pass "$3"; else row "$1" FAIL "$3"; fi; }
show() { systemctl show -P "$1" "$UNIT"; }
now() { cut -d' ' -f1 /proc/uptime; }
since() { echo "$1 $(now)" | awk '{printf "%.1f", $2 - $1}'; }
# frames that the newest status line counts, both eyes together
frames() { show StatusText | sed -n 's/.*[^0-9]\([0-9]\+\)+\([0-9]\+\) frames.*/\1 \2/p' | awk '{n = $1 + $2} END {print n + 0}'; }
# until_true SECONDS CONDITION: succeeds when the condition holds in time
until_true() {
    limit=$(now | awk -v s="$1" '{print $1 + s}')
    until eval "$2"; do
        now | awk -v l="$limit" '{exit $1 > l}' || return 1
        sleep 0.5
    done
}
as_user() { runuser -u calm-edge -- "$@"; }

dmsetup create data --table "0 $SECTORS linear /dev/vda 0"
mkdir -p "$DATA"
mount /dev/mapper/data "$DATA"

give_up() {
    journalctl -u "$UNIT" --no-pager -o short-monotonic | tail -60
    exit 1
}

if ! dpkg-query -W calm-edge >/dev/null 2>&1; then
    start=$(now)
    dpkg -i /mnt/calm-edge_*.deb
    judge install "[ $? = 0 ]" "dpkg -i in the booted machine, $(since $start) s (emulated)"
fi
judge "not started by itself" '[ "$(show ActiveState)" = inactive ]' "after installation: $(show ActiveState)"
as_user calm-edge cameras
cat > /etc/calm-edge/calm-edge.toml <<C
[capture]
primary = "v4l2:platform:vivid-000"
assistant = "v4l2:platform:vivid-001"
width_px = 320
height_px = 180
rate_hz = 5.0
realtime_priority = 5
C

start=$(now)
systemctl start "$UNIT"
[ "$(show ActiveState)" = active ] || give_up
judge start '[ "$(show ActiveState)" = active ]' "$(show ActiveState), READY after $(since $start) s (emulated)"
PID=$(show MainPID)
until_true 60 '[ "$(frames)" -gt 0 ]' || give_up
before=$(frames); sleep 20; after=$(frames)
judge "records for 20 s" '[ "$after" -gt "$before" ] && [ "$(show NRestarts)" = 0 ]' \
    "$before -> $after frames, $(show NRestarts) restarts; $(show StatusText)"
judge "unprivileged" '[ "$(stat -c %U /proc/$PID)" = calm-edge ]' \
    "runs as $(stat -c %U /proc/$PID), capabilities $(sed -n 's/CapEff:\t//p' /proc/$PID/status)"
threads=$(for t in /proc/$PID/task/*; do chrt -p "${t##*/}"; done | grep -c FIFO)
judge "real-time capture" '[ "$threads" -ge 3 ]' "$threads threads are SCHED_FIFO"
for f in tcp tcp6 udp udp6; do tail -n +2 /proc/net/$f; done > /tmp/sockets
judge "nothing listens" '[ ! -s /tmp/sockets ]' "$(wc -l < /tmp/sockets) internet sockets in the machine"
complaints=$(journalctl -b -u systemd-udevd -o cat | grep -c 99-calm-edge)
judge "udev rules" '[ "$complaints" = 0 ] && ls /dev/calm-edge/camera-* >/dev/null' \
    "$complaints complaints; $(ls -m /dev/calm-edge)"
entries=$(journalctl -u "$UNIT" CALM_EDGE_STATE=STARTING -o cat | wc -l)
judge "journal fields" '[ "$entries" -ge 1 ]' "$(journalctl -u "$UNIT" -F CALM_EDGE_STATE | tr '\n' ' ')"

start=$(now)
kill -STOP "$PID"
until_true 60 '[ "$(show MainPID)" != "$PID" ] && [ "$(show MainPID)" != 0 ]'
# the time that systemd logged: systemctl itself takes a second in emulation
took=$(show ExecMainStartTimestampMonotonic | awk -v s="$start" '{printf "%.1f", $1 / 1e6 - s}')
judge "hang: watchdog" 'awk "BEGIN {exit !($took <= 10)}"' "a new process after $took s; result of the old: $(journalctl -u "$UNIT" -o cat | grep -o "Watchdog timeout" | tail -1)"
until_true 180 '[ "$(show ActiveState)" = active ] && [ "$(frames)" -gt 0 ]'
judge "hang: back" '[ "$(show ActiveState)" = active ]' "frames again after $(since $start) s (emulated)"

start=$(now)
systemctl stop "$UNIT"
judge "SIGTERM" '[ "$(show Result)" = success ] && awk "BEGIN {exit !($(since $start) < 60)}"' \
    "$(since $start) s, result $(show Result)"
ls -l $DATA/*
last=$(ls -d $DATA/0* | tail -1)
parts=$(ls "$last" | grep -c 'part$')
judge "SIGTERM: segment closed" '[ "$parts" = 0 ]' "$parts open segments in ${last##*/}"
for drive in $DATA/0*; do
    as_user calm-edge validate "$drive"; rc=$?
    echo "validate ${drive##*/}: exit $rc"
done
as_user calm-edge validate "$last"
judge "SIGTERM: whole" "[ $? = 0 ]" "calm-edge validate ${last##*/}"

systemctl start "$UNIT"
until_true 60 '[ "$(frames)" -gt 20 ]'
PID=$(show MainPID)
dmsetup suspend --noflush --nolockfs data
dmsetup reload data --table "0 $SECTORS flakey /dev/vda 0 0 3600 1 error_writes"
dmsetup resume data
sleep 8; before=$(frames); sleep 8; after=$(frames)
judge "disk fails: goes on" '[ "$(show MainPID)" = "$PID" ] && [ "$after" -gt "$before" ]' \
    "same process, $before -> $after frames while every write fails; $(show StatusText)"
systemctl stop "$UNIT"
umount "$DATA"
dmsetup suspend --noflush --nolockfs data
dmsetup reload data --table "0 $SECTORS linear /dev/vda 0"
dmsetup resume data
e2fsck -p /dev/mapper/data; rc=$?
mount /dev/mapper/data "$DATA"
as_user calm-edge validate "$last"; kept=$?
judge "disk fails: earlier drive" "[ $rc -le 1 ] && [ $kept = 0 ]" "e2fsck exit $rc, earlier drive validates: exit $kept"

size() { find $DATA -name '*.mcap*' -exec cat {} + | wc -c; }
before=$(size)
dpkg -P calm-edge; rc=$?
judge "purge" "[ $rc = 0 ] && [ ! -e /opt/calm-edge ] && [ $before = $(size) ] && [ $before -gt 100000 ]" \
    "exit $rc; $(size) bytes of recordings kept"
journalctl -u "$UNIT" --no-pager -o short-monotonic | tail -80
