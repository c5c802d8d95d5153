#!/usr/bin/env bash
# In the guest: writes JPEGs of 320x180, five a second and in no order, into a device of v4l2loopback. FOLDER
# is a link, which may be turned at any time; while it points to nothing, nothing is written.
#
#   jpeg_feeder.sh FOLDER DEVICE
set -euo pipefail
exec 3>"$2"  # while it is open the device keeps its format
v4l2-ctl -d "$2" --set-fmt-video-out=width=320,height=180,pixelformat=MJPG
# Of the shell's own as far as it goes: for an emulated processor it is the processes that take long.
exec 4<> <(:)  # from which nothing comes: reading it is a sleep
while :; do
  frame=
  # The link may be turned before the frame is read: it is followed here.
  if cd -P "$1" 2>/dev/null; then
    frames=("$PWD"/*.jpg)
    frame=${frames[RANDOM % ${#frames[@]}]}
  fi
  # A frame is what one write() brings: cat's are of 128 KB.
  [[ -z $frame ]] || cat "$frame" >&3
  read -rt 0.2 -u 4 || true
done
