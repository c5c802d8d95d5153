# What systemd, the package and the machine do. Sourced by run.sh.

# Some 20 s on an idle machine; on one that is busy with other things, minutes.
boots() { within 600 wait_guest 600; }

# The unit is active only after READY=1, which without a camera is the declared wait.
service_is_ready() { on_guest systemctl is-active --quiet lcdm; }
state_is() { [[ $(status .device.state) == "$1" ]]; }

package_installs() {
  # A host busy with other things may leave an emulated processor standing for long.
  on_guest 'mkdir -p /etc/systemd/system.conf.d
    printf "[Manager]\nRuntimeWatchdogSec=40s\n" >/etc/systemd/system.conf.d/zz-guest.conf'
  to_guest "$package" /root/lcdm.deb
  on_guest 'dpkg -i /root/lcdm.deb && systemctl is-enabled lcdm lcdm-poweroff.path' >&2 || return
  within 90 service_is_ready
}

# Nobody has touched the configuration, and no camera is there: it is waited for, and the rendered
# scene is not shown in its place. With everything that is checked, the USB cable's network is enabled
# (usb_comes_with_boot).
boots_as_shipped() {
  local boot
  ! $all || usb_is_enabled || return
  boot=$(boot_number)
  on_guest systemctl reboot >&2 || true
  hang_up
  within 600 wait_guest 600 "$boot" >&2 || return
  within 120 service_is_ready >&2 || return
  on_guest 'dpkg -V lcdm | grep lcdm.toml' >&2 && return 1
  on_guest 'curl -sf --max-time 10 localhost:8080/status.json' >"$work/shipped.json" || return
  jq -re '"\(.source.uri): \(.device.state)"' "$work/shipped.json" | tee "$work/shipped"
  [[ $(<"$work/shipped") == 'v4l2:any: waiting for camera' ]]
}

# As shipped 15 s; for this guest's sake only as long as one looks.
hardware_watchdog_is_set() {
  local mine=/etc/systemd/system.conf.d/zz-guest.conf shipped
  shipped=$(on_guest "mv $mine /run/ && systemctl daemon-reexec
    systemctl show -p RuntimeWatchdogUSec --value; mv /run/${mine##*/} $mine && systemctl daemon-reexec")
  echo "$shipped"
  [[ $shipped == 15s ]]
}

recordings_are_private() {
  local modes
  modes=$(on_guest 'stat -c "%a %U" /var/lib/lcdm /var/lib/lcdm/recordings | sort -u')
  echo "$modes"
  [[ $modes == '750 lcdm' ]]
}

# From here on a network small enough for an emulated processor, and a page that we can reach.
configure_service() {
  on_guest "mkdir -p /etc/systemd/system/lcdm.service.d
    cat >/etc/systemd/system/lcdm.service.d/guest.conf" <<'END'
[Service]
Environment=LCDM_MODEL_WIDTH=64 LCDM_MODEL_HEIGHT=64
Environment=LCDM_CAMERA_WIDTH=320 LCDM_CAMERA_HEIGHT=180 LCDM_CAMERA_FRAMES_PER_SECOND=5
Environment=LCDM_HTTP_LISTEN=0.0.0.0
END
  on_guest 'systemctl daemon-reload && systemctl restart lcdm' >&2 || return
  within 90 service_is_ready
}

# set_service [NAME=VALUE...]: what else is in the service's environment, in force after a restart.
set_service() {
  {
    echo '[Service]'
    (($# == 0)) || printf 'Environment="%s"\n' "$@"
  } | on_guest 'cat >/etc/systemd/system/lcdm.service.d/more.conf && systemctl daemon-reload &&
    systemctl restart lcdm' >&2
}

waits_without_camera() {
  state_is 'waiting for camera' || return
  [[ $(on_guest systemctl show lcdm -p NRestarts --value) == 0 ]] || return
  [[ $(http_code /healthz) == 503 && $(http_code /depth.png) == 503 ]] || return
  on_guest systemctl show lcdm -p StatusText --value
}

# Lower is better; a unit without any of it has 9.6.
exposure() {
  local score
  on_guest 'systemd-analyze verify lcdm.service lcdm-poweroff.path lcdm-usb.service' >&2 || return
  score=$(on_guest "systemd-analyze security lcdm --no-pager" | sed -n 's/.*level for .*: \([0-9.]*\).*/\1/p')
  echo "$score"
  [[ -n $score && ${score/./} -le 20 ]]
}

control_is_refused() {
  local code
  code=$(http_code /record/start -X POST)
  echo "POST /record/start from another machine: $code"
  [[ $code == 401 || $code == 403 ]]
}

# As systemd/README.md has people do it; purging takes it away.
token=appliance-4711-once
set_token() { on_guest "install -m 640 -g lcdm /dev/stdin /etc/lcdm/token <<<$token" >&2; }

# With a token the same is allowed to those who know it. The account of the service reads it, and it
# is in no log.
control_needs_the_token() {
  local codes
  set_token || return
  set_service LCDM_HTTP_TOKEN_FILE=/etc/lcdm/token
  within 60 depth_flows >&2 || return
  codes="$(http_code /record/stop -X POST) $(http_code /record/stop -X POST -H 'Authorization: Bearer wrong')"
  codes+=" $(http_code /record/stop -X POST -H "Authorization: Bearer $token")"
  echo "without, with another, with the token: $codes"
  ! on_guest "journalctl -b | grep $token" >&2 || return
  set_service
  within 60 depth_flows >&2 && [[ $codes == '401 401 200' ]]
}

control_is_open() {
  local code
  set_service LCDM_HTTP_INSECURE=true
  within 60 depth_flows >&2 || return
  code=$(http_code /record/stop -X POST)
  set_service
  echo "POST /record/stop without a token: $code"
  within 60 depth_flows >&2 && [[ $code == 200 ]]
}

# Beside the service that works there is nothing it calls a fault.
doctor_finds_no_fault() {
  local rc=0
  on_guest 'lcdm doctor --config /etc/lcdm/lcdm.toml' >&2 || rc=$?
  on_guest 'lcdm doctor --config /etc/lcdm/lcdm.toml --json' >"$work/doctor.json" || rc=$?
  jq -r '[.[].severity] | group_by(.) | map("\(length) \(.[0])") | join(", ")' "$work/doctor.json"
  return "$rc"
}

# Either way of standing still: systemd kills it and starts another.
freeze_process() { on_guest systemctl kill -s STOP lcdm; }
# Only the thread that infers is held, in a group of its own: everything else answers, and the ping
# must stop all the same.
freeze_inference() {
  on_guest 'task=$(grep -lx infer /proc/$(systemctl show lcdm -p MainPID --value)/task/*/comm) &&
    task=${task%/comm} && cd /sys/fs/cgroup/system.slice/lcdm.service && mkdir held &&
    echo threaded >held/cgroup.type && echo ${task##*/} >held/cgroup.threads && echo 1 >held/cgroup.freeze' >&2
}
watchdog_restarts() {
  local before missed begin
  before=$(on_guest systemctl show lcdm -p NRestarts --value)
  missed=$(missed_pings)
  begin=$EPOCHREALTIME
  "$1" || return
  within 60 service_was_restarted "$before" >&2 || return
  within 60 depth_flows >&2 || return
  echo "$(seconds "$(elapsed_ms "$begin")"), $(missed_pings) in this boot"
  (($(missed_pings) > missed))
}
# The kernel kills what grows over MemoryMax=, here made smaller than the arena that is locked, and systemd
# starts another.
memory_limit_restarts() {
  local before begin
  before=$(on_guest systemctl show lcdm -p NRestarts --value)
  on_guest systemctl set-property --runtime lcdm MemoryMax=16M >&2
  within 60 service_was_restarted "$before" >&2 || return
  begin=$EPOCHREALTIME
  on_guest 'systemctl set-property --runtime lcdm MemoryMax=1G && rm -r /run/systemd/system.control/lcdm.service.d &&
    systemctl daemon-reload && journalctl -b -u lcdm | grep -q "oom-kill"' >&2 || return
  within 60 depth_flows >&2 || return
  echo "depth again $(seconds "$(elapsed_ms "$begin")") after the limit was as before"
}
# How often systemd itself has said so.
missed_pings() { on_guest journalctl -b -u lcdm | grep -c 'Watchdog timeout'; }
service_was_restarted() { (($(on_guest systemctl show lcdm -p NRestarts --value) > $1)); }

# The kernel crashes and hangs: the machine is reset, boots, and depth flows again by itself.
hardware_watchdog_resets() {
  local boot begin
  boot=$(boot_number)
  on_guest 'echo vivid >/etc/modules-load.d/vivid.conf; sync; (sleep 1; echo c >/proc/sysrq-trigger) \
    </dev/null >/dev/null 2>&1 &'
  begin=$EPOCHREALTIME
  hang_up
  within 600 wait_guest 600 "$boot" >&2 || return
  within 120 depth_flows >&2 || return
  seconds "$(elapsed_ms "$begin")"
}

# By the guest's own clock, from the kernel's first moment.
boot_to_depth() {
  on_guest journalctl -b -u lcdm -o short-monotonic |
    sed -n 's/^\[ *\([0-9]*\.[0-9]\).* streaming$/\1 s/p' | head -1 | grep .
}

# The plug is pulled after 9 s of recording; after the next boot all but the last second is there. Two
# more are for the start on a busy machine.
power_cut_keeps_recording() {
  local file begin span_ns
  [[ -d tests/peers/node_modules ]] ||
    { echo 'what reads the recording is not there: npm install in tests/peers'; return "$cannot"; }
  on_guest 'curl -sf -X POST localhost:8080/record/start && sleep 9' >&2 || return
  file=$(status .recording.file) || return
  kill_guest
  start_guest
  begin=$EPOCHREALTIME
  within 600 wait_guest 600 >&2 || return
  within 120 depth_flows >&2 || return
  on_guest "cat '/var/lib/lcdm/${file#/var/lib/lcdm/}'" >"$work/cut.mcap" || return
  node tests/peers/read_mcap.mjs "$work/cut.mcap" --stream >"$work/cut.json" || return
  span_ns=$(jq -re '[.messages[].stamp | tonumber] | max - min' "$work/cut.json") || return
  echo "$(jq '.messages | length' "$work/cut.json") messages over $(seconds $((span_ns / 1000000))); depth again $(seconds "$(elapsed_ms "$begin")")"
  ((span_ns > 6000000000))
}

# A newer package, whose configuration changed in a line: what the user wrote is kept, the new file
# lies beside it, and the service is another process. The cable, over which somebody may be upgrading,
# stays up.
package_upgrades() {
  local before cable
  on_guest 'modprobe dummy_hcd && systemctl enable --now lcdm-usb' >&2 || return
  cable=$(cable_up_since) || return
  before=$(on_guest systemctl show lcdm -p MainPID --value) || return
  on_guest 'echo "# mine" >>/etc/lcdm/lcdm.toml && cd /root && rm -rf newer && dpkg-deb -R lcdm.deb newer &&
    sed -i "s/^Version: .*/&+newer/" newer/DEBIAN/control && echo "# newer" >>newer/etc/lcdm/lcdm.toml &&
    dpkg-deb -Zgzip -z1 -b newer newer.deb && dpkg -i --force-confdef --force-confold newer.deb &&
    grep -q "# mine" /etc/lcdm/lcdm.toml && grep -q "# newer" /etc/lcdm/lcdm.toml.dpkg-dist' >&2 || return
  within 90 depth_flows >&2 || return
  on_guest "dpkg-query -W -f '\${Version}' lcdm" && echo
  [[ $(on_guest systemctl show lcdm -p MainPID --value) != "$before" && $(cable_up_since) == "$cable" ]]
}
cable_up_since() {
  on_guest 'systemctl is-active --quiet lcdm-usb && systemctl show lcdm-usb -p ActiveEnterTimestampMonotonic --value'
}

# Where no check's settings are left, which may name the token.
package_purges() {
  set_service && set_token || return
  on_guest 'dpkg -r lcdm && ! systemctl is-active --quiet lcdm && test -e /etc/lcdm/lcdm.toml &&
    test -e /etc/lcdm/token && test -d /var/lib/lcdm/recordings &&
    [ ! -e /sys/kernel/config/usb_gadget/lcdm ]' >&2 || return
  on_guest 'dpkg -P lcdm && [ -z "$(ls -d /etc/lcdm /var/lib/lcdm /usr/share/lcdm /usr/bin/lcdm \
    /etc/systemd/system/*.wants/lcdm* 2>/dev/null)" ] && [ -z "$(systemctl --failed --quiet --no-legend)" ]' >&2
}

# Devices that are there already get their groups from the package. Those of the kernel's own are
# taken back before.
package_finds_devices() {
  local groups
  on_guest 'chown root:root /dev/gpiochip* && chmod 600 /dev/gpiochip*' >&2 || return
  package_installs >&2 || return
  groups=$(on_guest 'udevadm settle && stat -c "%n %G %a" /dev/gpiochip*')
  echo "$groups" | paste -sd, -
  ! grep -v ' gpio 660$' <<<"$groups" >&2
}
