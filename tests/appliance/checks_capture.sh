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

# 16 bits, grey, and a size that the status says; its picture stays for people to look at. An emulated
# processor may have no picture within the service's own patience: 503 with a Retry-After, which curl heeds.
depth_picture() {
  local file=build/appliance/depth.png header
  curl -sf --retry 9 --retry-max-time 60 --max-time 20 -o "$file" "$web/depth.png" || return
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

# What the ladder's counters rose by since they were BEFORE: {"reopenings":1}.
ladder() { status '.recovery | tostring'; }
ladder_since() {
  status ".recovery | with_entries(.value -= ($1)[.key] | select(.value != 0)) | tostring"
}
ladder_was_used() { [[ $(ladder_since "$1") != '{}' ]]; }

# recovers RUNGS FAULT...: the fault comes after depth was steady (10 s), so that the ladder begins at
# its first rung, and is gone when FAULT ends. Depth comes back, and RUNGS, a filter of jq, is true of
# what the ladder's counters rose by.
recovers() {
  local rungs=$1 before begin used
  shift
  within 60 depth_flows >&2 || return
  sleep $((11 * patience))
  before=$(ladder) || return
  begin=$EPOCHREALTIME
  "$@" || return
  within 30 ladder_was_used "$before" >&2 || return
  within 30 depth_flows >&2 || return
  used=$(ladder_since "$before")
  echo "$(seconds "$(elapsed_ms "$begin")"), $used"
  jq -e "$rungs" <<<"$used" >&2
}

# The stream runs, but for two seconds no frame comes.
stall() {
  on_guest 'v4l2-ctl -d /dev/video0 -c percentage_of_dropped_buffers=100; sleep 2
    v4l2-ctl -d /dev/video0 -c percentage_of_dropped_buffers=0' >&2
}

# A driver that refuses its buffers, or the start of its stream, once: the service is up and tries
# again by itself.
start_is_refused() {
  local refusal begin
  for refusal in inject_vidioc_reqbufs_error inject_vidioc_qbuf_error inject_vidioc_streamon_error; do
    on_guest "systemctl stop lcdm && v4l2-ctl -d /dev/video0 -c $refusal=1 && systemctl start lcdm" >&2 || return
    begin=$EPOCHREALTIME
    within 60 depth_flows >&2 || return
    echo "$refusal: $(seconds "$(elapsed_ms "$begin")"), $(ladder)" | tee -a /dev/stderr
    [[ $(on_guest systemctl show lcdm -p NRestarts --value) == 0 ]] || return
  done
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

# By its place on the bus and by its name; udev makes a link for the first.
selected_by_place_and_name() {
  local link
  link=$(on_guest 'ls /dev/v4l/by-path/*video-index0 | head -1') && [[ -n $link ]] || return
  set_service "LCDM_CAMERA_SOURCE=v4l2:$link"
  within 60 depth_flows >&2 && [[ $(status .source.uri) == "v4l2:$link" ]] || return
  set_service LCDM_CAMERA_SOURCE=v4l2:name=vivid
  within 60 depth_flows >&2 || return
  echo "$link; name=vivid is $(status .source.uri)"
}

# What the configuration says of the picture is in force in the driver.
controls_are_set() {
  set_service LCDM_CAMERA_GAIN=77
  within 60 depth_flows >&2 || return
  on_guest 'v4l2-ctl -d /dev/video0 -C gain,gain_automatic' | paste -sd' ' | tee "$work/controls"
  [[ $(<"$work/controls") == 'gain: 77 gain_automatic: 0' ]] || return
  set_service
  within 60 depth_flows
}

# Each format that we read, from the queue that there is: the service starts with it, and its frames
# become depth.
every_format() {
  local format seen=
  for format in NV12 YUYV UYVY NV21 RGB24 BGR24 GREY; do
    set_service "LCDM_CAMERA_FORMAT=$format"
    within 60 depth_flows >&2 || { echo "no depth from $format"; return 1; }
    status .source.description >&2
    status .source.description | grep -q " $format " || { echo "asked for $format"; return 1; }
    seen+="$format "
  done
  set_service
  within 60 depth_flows >&2 || return
  echo "$seen"
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
