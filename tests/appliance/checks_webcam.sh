# A USB camera whose driver is the kernel's, for all webcams: webcam.cpp on a simulated bus. Sourced by
# run.sh.

webcam=/usr/local/bin/webcam
webcam_folder=/dev/gadget

# The bus has room for one device: the board's own gadget goes.
webcam_comes() {
  local program=$work/webcam link driver
  "$compiler" -std=c++20 -O1 -o "$program" tests/appliance/webcam.cpp >&2 || return
  to_guest "$program" "$webcam" || return
  on_guest "systemctl stop lcdm-usb; modprobe -a dummy_hcd gadgetfs &&
    mkdir -p $webcam_folder && mount -t gadgetfs none $webcam_folder" >&2 || return
  link=$(webcam_link) || return
  set_service "LCDM_CAMERA_SOURCE=v4l2:$link"
  within 90 depth_flows >&2 || return
  driver=$(on_guest "basename \$(readlink /sys/class/video4linux/\$(basename \$(readlink $link))/device/driver)")
  echo "$link, $driver, $(status .source.description)"
  [[ $driver == uvcvideo ]]
}
# On a busy machine the simulated controller may lose an answer to the driver, which then wants the camera
# plugged in anew.
webcam_link() {
  local link
  for _ in 1 2 3; do
    plug_webcam_in >&2 || return
    link=$(on_guest 'for i in $(seq 60); do ls /dev/v4l/by-id/*video-index0 2>/dev/null && break; sleep 0.5; done')
    [[ -z $link ]] || break
    on_guest systemctl stop webcam >&2 || return
  done
  echo "$link" | grep .
}
plug_webcam_in() { on_guest "systemd-run --quiet -p KillMode=mixed --unit webcam $webcam $webcam_folder"; }

# Its firmware hangs: it answers the host, but there are no frames, whatever stream is begun or opened.
webcam_hangs() { on_guest 'pkill -STOP -P $(systemctl show webcam -p MainPID --value)' >&2; }

webcam_unplugged() {
  local begin said=true
  on_guest systemctl stop webcam >&2 || return
  within 20 state_is 'waiting for camera' >&2 || said=false
  sleep 2
  begin=$EPOCHREALTIME
  webcam_link >&2 || return
  within 60 depth_flows >&2 || return
  echo "$(seconds "$(elapsed_ms "$begin")") after it is back"
  $said
}

# The bus is free again, and the shipped source takes the other camera.
webcam_goes() {
  on_guest "systemctl stop webcam; umount $webcam_folder" >&2
  set_service
  within 60 depth_flows
}
