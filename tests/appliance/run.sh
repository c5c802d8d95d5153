#!/usr/bin/env bash
# Boots a Debian under QEMU, installs our package in it and checks from outside and inside that it
# streams depth from the kernel's own test drivers and comes back from every fault.
#
#   tests/appliance/run.sh           what continuous integration runs
#   tests/appliance/run.sh --all     also what takes long or needs kernel modules built
#     --arch arm64                   the same on a guest with another processor (default: amd64)
#     --package FILE                 this package (default: ./package.sh makes one)
#     --keep                         leaves the guest running and says how to reach it
#
# Needs root for making the disk, not for running it. Everything is kept in build/appliance.
set -euo pipefail
cd "$(dirname "$0")/../.."

all=false keep=false package= arch=amd64
while [[ $# -gt 0 ]]; do
  case $1 in
    --all) all=true ;;
    --keep) keep=true ;;
    --arch) arch=${2:?"run.sh: --arch wants amd64 or arm64"}; shift ;;
    --package) package=${2:?"run.sh: --package wants a file"}; shift ;;
    -h | --help) sed -n '2,11s/^# \{0,1\}//p' "$0"; exit 0 ;;
    *) echo "run.sh: unknown option '$1': see tests/appliance/run.sh --help" >&2; exit 2 ;;
  esac
  shift
done

here=tests/appliance
. $here/report.sh
. $here/guest.sh
. $here/checks_service.sh
. $here/checks_capture.sh
. $here/checks_board.sh
. $here/checks_webcam.sh

finish() {
  if $keep && [[ -n $guest_pid ]]; then
    echo "guest (process $guest_pid): ssh ${ssh_options[*]} -p $ssh_port root@127.0.0.1; $web/"
  else
    close_guest "$1"
  fi
}

open_guest run "$arch"
trap 'finish $?' EXIT
check 'boots' boots
((failures == 0)) || { tail -20 "$work/console.log"; exit 1; }
check 'package installs, service is ready' package_installs
check 'boots as shipped: waits for a camera' boots_as_shipped
if $all; then check 'USB: page over the cable after a boot' usb_comes_with_boot; fi
check 'recordings are private' recordings_are_private
check 'hardware watchdog as shipped' hardware_watchdog_is_set
check 'exposure 2.0 or better' exposure
check 'Jetson: clocks up and back' jetson_power
check 'service for an emulated processor' configure_service
check 'no camera: a declared wait' waits_without_camera
check 'camera arrives after boot' camera_arrives
check 'depth as a 16-bit picture' depth_picture
check 'frame with the error flag' broken_frame
check 'frames lost' lost_frames
check 'fatal streaming error' recovers '. == {stream_restarts: 1}' vivid inject_fatal_streaming_error=1
check 'stream stalls' recovers '.stream_restarts == 1 and .port_resets == null' stall
check 'source changes its format' recovers '. == {reopenings: 1}' vivid colorspace=1
check 'camera disconnected' recovers '. == {device_waits: 1}' vivid disconnect=1
check 'camera refuses to start' start_is_refused
check 'camera unplugged for seconds' camera_unplugged
check 'stamps: those that can be' stamps_are_judged
check 'buffers as dma-bufs' buffers_are_shared
check 'camera by its place and its name' selected_by_place_and_name
check 'gain from the configuration' controls_are_set
check 'multi-planar camera' several_planes
if $all; then check 'every format, multi-planar' every_format; fi
check 'camera under another number' another_number
if $all; then check 'every format, one plane' every_format; fi
check 'control from outside is off' control_is_refused
check 'control from outside needs the token' control_needs_the_token
check 'control from outside, insecure by will' control_is_open
check 'doctor' doctor_finds_no_fault
check 'process stands still: systemd watchdog' watchdog_restarts freeze_process
check 'inference stalls: systemd watchdog' watchdog_restarts freeze_inference
check 'memory grows over its limit' memory_limit_restarts
check 'kernel crashes: hardware watchdog' hardware_watchdog_resets
check 'boot to first depth' boot_to_depth
check 'power cut while recording' power_cut_keeps_recording
if $all; then
  check 'drivers for the board' board_modules
  check 'GPIO: lines by name' gpio_set_up
  check 'GPIO: light' gpio_light
  check 'GPIO: heartbeat' gpio_heartbeat
  check 'GPIO: heartbeat stands still in a fault' gpio_heartbeat_stops
  check 'GPIO: safe levels at the end' gpio_ends_safe
  check 'GPIO: button records' gpio_button
  check 'USB: page over the cable' usb_network
  check 'USB: control needs the token' usb_control_needs_the_token
  check 'USB: no address, then one' usb_failed_up
  check 'USB: down and up' usb_down_and_up
  check 'webcam: uvcvideo on a USB bus' webcam_comes
  check 'webcam hangs: port reset' recovers '.port_resets == 1' webcam_hangs
  check 'webcam unplugged' webcam_unplugged
  check 'webcam goes' webcam_goes
  check 'libcamera: vimc' libcamera_streams
fi
check 'package upgrades' package_upgrades
check 'package removes and purges' package_purges
if $all; then
  check 'package installs again, beside its devices' package_finds_devices
  check 'GPIO: button held powers off' gpio_power_off
fi
print_checks
((failures == 0))
