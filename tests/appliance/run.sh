#!/usr/bin/env bash
# Boots a Debian under QEMU, installs our package in it and checks from outside and inside that it
# streams depth from the kernel's own test drivers and comes back from every fault.
#
#   tests/appliance/run.sh           what continuous integration runs
#   tests/appliance/run.sh --all     also what takes long or needs kernel modules built
#     --package FILE                 this package (default: ./package.sh makes one)
#     --keep                         leaves the guest running and says how to reach it
#
# Needs root for making the disk, not for running it. Everything is kept in build/appliance.
set -euo pipefail
cd "$(dirname "$0")/../.."

all=false keep=false package=
while [[ $# -gt 0 ]]; do
  case $1 in
    --all) all=true ;;
    --keep) keep=true ;;
    --package) package=${2:?"run.sh: --package wants a file"}; shift ;;
    -h | --help) sed -n '2,10s/^# \{0,1\}//p' "$0"; exit 0 ;;
    *) echo "run.sh: unknown option '$1': see tests/appliance/run.sh --help" >&2; exit 2 ;;
  esac
  shift
done

architecture=$(dpkg --print-architecture)
if [[ $architecture != amd64 ]]; then
  echo "run.sh: skipped: no guest for $architecture yet"
  exit 0
fi
[[ -n $package ]] || package=$(./package.sh | tail -1)

here=tests/appliance
guest=$PWD/build/appliance/$architecture
work=$(mktemp -d "$PWD/build/appliance/run.XXXX")
. $here/report.sh
. $here/guest.sh
. $here/checks_service.sh
. $here/checks_capture.sh

finish() {
  if $keep && [[ -n $guest_pid ]]; then
    echo "guest (process $guest_pid): ssh ${ssh_options[*]} -p $ssh_port root@127.0.0.1; $web/"
    return
  fi
  kill_guest
  ((failures > 0)) || rm -rf "$work"
}
trap finish EXIT

$here/guest_image.sh "$package" "$guest"
new_disk
start_guest
check 'boots' boots
check 'package installs, service runs' package_installs
check 'camera arrives after boot' camera_arrives
check 'depth as a 16-bit picture' depth_picture
print_checks
((failures == 0)) || { echo "logs: $work"; exit 1; }
