# The guest: QEMU without KVM, reached by ssh and HTTP through forwarded loopback ports. Sourced.
#
# Its disk is an overlay over the image, so that every run begins with a machine that never booted.

. tests/appliance/architecture.sh

guest=  # image, kernel and key
work=   # the folder of this run: disk, console, logs
guest_pid=

# open_guest NAME ARCHITECTURE: switches a new guest on, in which $package (made now, if it is empty)
# can be installed. On a machine that can have none it says so and ends. NAME is the caller's.
open_guest() {
  local reason
  set_architecture "$2"
  guest=$(guest_folder)
  reason=$(why_no_guest)
  [[ -z $reason ]] || { echo "$1.sh: skipped: $reason"; exit 0; }
  [[ -n $package ]] || package=$(make_package | tail -1)
  mkdir -p "$guest"
  work=$(mktemp -d "$PWD/build/appliance/$1.XXXX")
  trap 'close_guest $?' EXIT
  ssh_options=(
    -i "$guest/key" -o UserKnownHostsFile=/dev/null -o StrictHostKeyChecking=no -o LogLevel=ERROR
    -o ConnectTimeout=20 -o ServerAliveInterval=10 -o ServerAliveCountMax=6
    -o ControlMaster=auto -o ControlPath="$work/ssh" -o ControlPersist=600
  )
  tests/appliance/guest_image.sh "$package" "$guest" "$architecture"
  new_disk
  start_guest
}

# close_guest STATUS: ends it; the logs are kept unless all went well.
close_guest() {
  if (($1 != 0)); then
    [[ -z $guest_pid ]] || timeout 60 ssh "${ssh_options[@]}" -p "$ssh_port" root@127.0.0.1 \
      journalctl --no-pager >"$work/journal.log" 2>/dev/null || true
    echo "logs: $work"
  fi
  kill_guest
  if (($1 == 0)); then rm -rf "$work"; else rm -f "$work/disk.qcow2"; fi
}

# Why no guest can be booted on this machine; nothing when one can.
why_no_guest() {
  local tool
  [[ $(dpkg --print-architecture) == amd64 ]] || { echo 'guests are booted on amd64'; return; }
  [[ $(. /etc/os-release && echo "$ID$VERSION_ID") == debian12 ]] || { echo 'the guest is a Debian 12'; return; }
  for tool in "${machine[0]}" qemu-img mmdebstrap mke2fs ssh curl jq node; do
    command -v "$tool" >/dev/null || { echo "no $tool: systemd/install-packages.sh test"; return; }
  done
  [[ $(id -u) -eq 0 ]] || { echo 'making its disk needs root'; return; }
  runs_here || { echo "no $architecture program runs here: qemu-user-static, binfmt_misc"; return; }
}

free_port() {
  local port
  while port=$((20000 + RANDOM % 20000)); do
    (: <"/dev/tcp/127.0.0.1/$port") 2>/dev/null || { echo "$port"; return; }
  done
}

# new_disk: a machine as it comes from the image.
new_disk() {
  qemu-img create -q -f qcow2 -b "$guest/disk.ext4" -F raw "$work/disk.qcow2"
}

# start_guest: power on. The console goes to $work/console.log.
start_guest() {
  ssh_port=$(free_port)
  web_port=$(free_port)
  web=http://127.0.0.1:$web_port
  # A kernel that crashes hangs, as panic=0 says: what resets it is the watchdog.
  "${machine[@]}" -accel tcg,thread=multi -smp 2 -m 1536 -display none \
    -serial "file:$work/console.log" -monitor none -kernel "$guest/vmlinuz" -initrd "$guest/initrd" \
    -append "console=$console root=/dev/vda rw quiet panic=0 mitigations=off audit=0 apparmor=0" \
    -drive "file=$work/disk.qcow2,if=virtio,cache=writeback" \
    -device i6300esb -action watchdog=reset -device virtio-rng-pci \
    -nic "user,model=virtio-net-pci,restrict=on,hostfwd=tcp:127.0.0.1:$ssh_port-:22,hostfwd=tcp:127.0.0.1:$web_port-:8080" \
    </dev/null >"$work/qemu.log" 2>&1 &
  guest_pid=$!
}

# on_guest COMMAND: runs it in the guest's shell as root.
on_guest() { ssh "${ssh_options[@]}" -p "$ssh_port" root@127.0.0.1 "$@"; }
to_guest() { scp -q "${ssh_options[@]}" -P "$ssh_port" "$1" "root@127.0.0.1:$2"; }

# The connection shared by commands; after a reset there is nobody at its other end.
hang_up() { ssh "${ssh_options[@]}" -O exit 127.0.0.1 >/dev/null 2>&1 || true; rm -f "$work/ssh"; }

boot_number() { on_guest cat /proc/sys/kernel/random/boot_id; }

# wait_guest SECONDS [NOT]: until the guest answers, in another boot than NOT. The limit is an amd64
# guest's.
wait_guest() {
  local end=$((SECONDS + $1 * patience)) boot
  while ((SECONDS < end)); do
    kill -0 "$guest_pid" 2>/dev/null || { cat "$work/qemu.log" >&2; return 1; }
    boot=$(boot_number 2>/dev/null) && [[ $boot != "${2:-}" ]] && return
    hang_up
    sleep 1
  done
  return 1
}

# The plug is pulled.
kill_guest() {
  hang_up
  [[ -z $guest_pid ]] || { kill -KILL "$guest_pid" && wait "$guest_pid"; } 2>/dev/null || true
  guest_pid=
}

# status FILTER: something of the service's status, by a filter of jq. Fails when the service is
# silent, and when there is no such thing in it (null).
status() { curl -sf --max-time 5 "$web/status.json" | jq -re "$1"; }

# http_code PATH [OPTION...]: the number a request is answered with.
http_code() { curl -s -o /dev/null --max-time 10 -w '%{http_code}' "$web$1" "${@:2}"; }
