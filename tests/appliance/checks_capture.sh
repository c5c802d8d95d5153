# Cameras that come, go and misbehave. Sourced by run.sh.

# depth_advances: a new depth frame came since the last call with the same counter.
inferred() { status .frames.inferred; }
depth_flows() {
  local before now
  before=$(inferred) && sleep 0.5 && now=$(inferred) && ((now > before))
}

camera_arrives() {
  on_guest modprobe vivid >&2
  within 60 depth_flows
}

# 16 bits, grey, of the size that the status says, and not one colour.
depth_picture() {
  local file=$work/depth.png size
  curl -sf --max-time 20 -o "$file" "$web/depth.png"
  size=$(od -An -tu1 -j16 -N10 "$file" | tr -s ' ' | sed 's/^ //')
  echo "bytes of the header: $size" >&2
  [[ $size == *' 16 0' ]] || return 1
  echo "$(stat -c %s "$file") bytes"
}
