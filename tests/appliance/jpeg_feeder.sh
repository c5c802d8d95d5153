#!/usr/bin/env bash
# In the guest: writes JPEGs of 320x180, five a second and in no order, into a device of v4l2loopback. What
# stands in the folder may change at any time; while nothing does, nothing is written.
#
#   jpeg_feeder.sh FOLDER DEVICE
set -euo pipefail
exec 3>"$2"  # while it is open the device keeps its format
v4l2-ctl -d "$2" --set-fmt-video-out=width=320,height=180,pixelformat=MJPG
while :; do
  frames=("$1"/*.jpg)
  frame=${frames[RANDOM % ${#frames[@]}]}
  # A frame is what one write() brings: cat's are of 128 KB.
  [[ ! -e $frame ]] || cat "$frame" >&3
  sleep 0.2
done
