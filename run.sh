#!/usr/bin/env bash
# Builds lcdm and runs it as a depth camera. Installs what is missing first; the address of the
# live page is printed when it is up. Ctrl-C stops it.
#
#   ./run.sh                      the first camera that really delivers, else a rendered scene
#   ./run.sh scene:               the rendered scene (no camera needed)
#   ./run.sh file:PATH            a video file or a folder of images
#   ./run.sh v4l2:/dev/video0     a camera
#   ./run.sh mcap:recordings/     what `lcdm record` wrote
#
# Everything after the source goes to `lcdm run`: ./run.sh scene: --listen 0.0.0.0
# Where the package is installed, its /etc/lcdm/lcdm.toml counts here too. Beside the running service,
# with a port of its own: ./run.sh --source auto --port 8081
set -euo pipefail
root=$(dirname "$(realpath "$0")")

case ${1:-} in
  -h | --help)
    sed -n '2,13s/^# \{0,1\}//p' "$0"
    exit 0
    ;;
esac

source=()
if [[ ${1:-} == *:* ]]; then
  source=(--source "$1")
  shift
fi

(
  cd "$root"
  systemd/install-packages.sh run
  [[ -f build/release/build.ninja ]] || cmake --preset release
  cmake --build --preset release
)
exec "$root/build/release/bin/lcdm" run "${source[@]}" "$@"
