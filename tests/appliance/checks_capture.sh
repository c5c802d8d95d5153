# Cameras that come, go and misbehave, as the kernel's driver `vivid` plays them. Sourced by run.sh.

inferred() { status .frames.inferred; }
depth_flows() {
  local before now
  before=$(inferred) && sleep 0.5 && now=$(inferred) && ((now > before))
}

# vivid NAME=VALUE: one of the driver's controls; buttons take 1.
vivid() { on_guest v4l2-ctl -d /dev/video0 -c "$1" >&2; }

unplug() { on_guest 'echo vivid.0 >/sys/bus/platform/drivers/vivid/unbind' >&2; }
plug_in() { on_guest 'echo vivid.0 >/sys/bus/platform/drivers/vivid/bind' >&2; }

# rises COUNTER BEFORE: whether that number of the status is above what it was.
rises() {
  local now
  now=$(status "$1") && ((now > $2))
}

camera_arrives() {
  on_guest modprobe vivid >&2
  within 120 depth_flows
}

# 16 bits, grey, and a size that the status says; its picture stays for people to look at.
depth_picture() {
  local file=build/appliance/depth.png header
  curl -sf --max-time 20 -o "$file" "$web/depth.png" || return
  header=$(od -An -v -tx1 -j16 -N10 "$file" | tr -d ' \n')
  [[ $header == "$(printf '%08x%08x1000' "$(status .depth.width)" "$(status .depth.height)")" ]] ||
    return
  echo "$(status .source.description), $(stat -c %s "$file") bytes in $file"
}

# A frame marked as broken is left out and counted; nothing else happens.
broken_frame() {
  local before reopened
  before=$(status .frames.corrupt) && reopened=$(status .frames.reopened) || return
  vivid inject_v4l2_buf_flag_error=1
  within 20 rises .frames.corrupt "$before" >&2 || return
  within 20 depth_flows || return
  (($(status .frames.reopened) == reopened))
}

# A third of the frames never comes: counted as gaps in the sequence.
lost_frames() {
  local before counted=true
  before=$(status .frames.sequence_gaps) || return
  vivid percentage_of_dropped_buffers=35
  within 30 rises .frames.sequence_gaps "$before" >&2 || counted=false
  vivid percentage_of_dropped_buffers=0
  within 20 depth_flows && $counted
}

# recovers COUNTER CONTROL: the fault is injected, the rung of the ladder counted (COUNTER: what of
# the status; which rung it is depends on how long depth had been steady), depth comes back.
recovers() {
  local before begin=$EPOCHREALTIME
  before=$(status "$1") || return
  vivid "$2=1"
  within 30 rises "$1" "$before" >&2 || return
  within 30 depth_flows >&2 || return
  echo "$(seconds "$(elapsed_ms "$begin")"), recovery: $(status '.recovery | map_values(select(. > 0)) | tostring')"
}

# Pulled out for seconds: said, shown, waited for; plugged in again.
camera_unplugged() {
  local begin said=true
  unplug
  within 20 state_is 'waiting for camera' >&2 || said=false
  [[ $(http_code /depth.png) == 503 && $(http_code /healthz) == 503 ]] || said=false
  sleep 3
  plug_in
  begin=$EPOCHREALTIME
  within 30 depth_flows >&2 || return
  echo "$(seconds "$(elapsed_ms "$begin")") after it is back"
  $said
}

# Where it stamps the end of frames, vivid names a moment that is still to come: no stamp at all. Of
# their start it names one that was.
stamps_are_judged() {
  stamp_is arrival || return
  on_guest 'systemctl stop lcdm && v4l2-ctl -d /dev/video0 -c timestamp_source=1 &&
    systemctl start lcdm' >&2 || return
  within 60 depth_flows >&2 || return
  status .source.stamp
  stamp_is 'start of exposure'
}
stamp_is() { [[ $(status .source.stamp) == "$1" ]]; }

# What lcdm probe finds out of a camera that nobody holds, here by the kernel's own exporter.
buffers_are_shared() {
  on_guest 'systemctl stop lcdm; lcdm probe --json; systemctl start lcdm' >"$work/probe.json" || return
  within 60 depth_flows >&2 || return
  jq -r '.v4l2[] | select(.usable) | "\(.path): dma_buf \(.dma_buf)"' "$work/probe.json" | grep 'dma_buf true'
}

# reload_camera OPTION...: the same driver, loaded again with these options.
reload_camera() {
  unplug
  within 30 state_is 'waiting for camera' >&2 || return
  # udev may still look at what is going away.
  within 30 on_guest modprobe -r vivid >&2 && on_guest modprobe vivid "$@" >&2 || return
  within 60 depth_flows >&2
}

# The other kind of queue.
several_planes() {
  reload_camera multiplanar=2 || return
  on_guest v4l2-ctl -d /dev/video0 -D | grep -q 'Video Capture Multiplanar' || return
  status .source.description
}

# As when a camera is plugged in again before its old number is free: the shipped source takes the
# one that there is.
another_number() {
  reload_camera vid_cap_nr=7 || return
  on_guest '[ -e /dev/video7 ] && [ ! -e /dev/video0 ]' || return
  echo "$(status .source.uri): $(on_guest 'ls /dev/video*')"
}
