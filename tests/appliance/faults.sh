# Faults that a camera, its clients and its disk can have. Sourced by soak.sh, after checks_capture.sh.
#
# Of a fault NAME, NAME_ends is what ends it, and the way back is timed from there. NAME_begins, where
# there is one, is what comes before; without one the fault is momentary.

# Of those that last.
some_seconds() { sleep $((1 + RANDOM % 4)); }

# ---- of the kernel's test driver ------------------------------------------------------------------
same_brightness_ends() { vivid brightness=128; }
broken_frames_ends() { vivid inject_v4l2_buf_flag_error=1; }
frames_lost_begins() { vivid percentage_of_dropped_buffers=60; some_seconds; }
frames_lost_ends() { vivid percentage_of_dropped_buffers=0; }
stream_error_ends() { vivid inject_fatal_streaming_error=1; }
disconnect_ends() { vivid disconnect=1; }
camera_gone_begins() { unplug; some_seconds; }
camera_gone_ends() { plug_in; }

# ---- of a camera that compresses its frames itself ------------------------------------------------
# Its frames come from a folder of JPEGs, by turns.
frames_from() { on_guest "ln -sfn $1 /root/frames/now"; }
same_frames_ends() { frames_from whole; }
frames_cut_begins() { frames_from cut; some_seconds; }
frames_cut_ends() { frames_from whole; }
frames_flipped_begins() { frames_from flipped; some_seconds; }
frames_flipped_ends() { frames_from whole; }
camera_silent_begins() { frames_from nowhere; some_seconds; }
camera_silent_ends() { frames_from whole; }

# jpeg_camera: in place of vivid stands v4l2loopback, into which the guest writes what vivid showed last.
jpeg_camera() {
  local modules
  modules=$(tests/appliance/guest_modules.sh "$guest" "$architecture" loopback) || return
  curl -s --max-time 10 -o "$work/stream" "$web/stream.mjpg?view=colour" || true
  node tests/appliance/spoil_jpegs.mjs "$work/stream" "$work/frames" "$RANDOM" || return
  tar -c -C "$modules" v4l2loopback.ko -C "$PWD/tests/appliance" jpeg_feeder.sh -C "$work" frames |
    on_guest 'tar -x --no-same-owner -C /root' || return
  frames_from whole
  on_guest 'insmod /root/v4l2loopback.ko video_nr=9 max_buffers=8 &&
    systemd-run -q --unit=jpeg-feeder bash /root/jpeg_feeder.sh /root/frames/now /dev/video9' >&2 || return
  unplug
  within 60 depth_flows >&2 && status .source.description | grep MJPEG
}

# ---- of everything else ---------------------------------------------------------------------------
# Connected, but reading a few bytes a second.
clients_stall_begins() {
  local clients=()
  for _ in 1 2 3; do
    curl -s --limit-rate 200 --max-time 6 -o /dev/null "$web/stream.mjpg" &
    clients+=($!)
  done
  wait "${clients[@]}"
}
clients_stall_ends() { true; }
slow_disk_begins() {
  on_guest 'systemctl set-property --runtime lcdm IOWriteBandwidthMax="/dev/vda 20K" &&
    curl -sf -o /dev/null -X POST localhost:8080/record/start; sleep 5
    curl -sf -o /dev/null -X POST localhost:8080/record/stop'
}
slow_disk_ends() { on_guest systemctl set-property --runtime lcdm IOWriteBandwidthMax=; }

# The world as it is without faults, also after one whose own end went wrong.
calm() {
  on_guest 'systemctl set-property --runtime lcdm IOWriteBandwidthMax=
    if [ -e /dev/video9 ]; then ln -sfn whole /root/frames/now; exit; fi
    v4l2-ctl -d /dev/video0 -c percentage_of_dropped_buffers=0
    cd /sys/bus/platform/drivers/vivid && [ -e vivid.0 ] || echo vivid.0 >bind'
}
