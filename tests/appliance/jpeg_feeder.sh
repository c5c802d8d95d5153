#!/usr/bin/env bash
# In the guest: writes JPEGs of 320x180, five a second and in no order, into a device of v4l2loopback. FOLDER
# is a link, which may be turned at any time; while it points to nothing, nothing is written.
#
#   jpeg_feeder.sh FOLDER DEVICE
set -euo pipefail
exec 3>"$2"  # while it is open the device keeps its format
v4l2-ctl -d "$2" --set-fmt-video-out=width=320,height=180,pixelformat=MJPG
while :; do
  frames=("$(readlink -f "$1")"/*.jpg)  # the link may be turned before the frame is read
  frame=${frames[RANDOM % ${#frames[@]}]}
  # A frame is what one write() brings: cat's are of 128 KB.
  [[ ! -e $frame ]] || cat "$frame" >&3
  sleep 0.2
done
