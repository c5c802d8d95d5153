#!/usr/bin/env bash
# Makes a folder with arm64's headers and libraries, which the preset `arm64` builds against.
#
#   tests/arm64/sysroot.sh [FOLDER]          default: build/sysroot-arm64; about 1.1 GB
#
# From the machine's own package sources, for the same release. Installs what it needs itself
# (mmdebstrap, the cross compiler, qemu-user-static); nothing outside FOLDER is unpacked.
set -euo pipefail
cd "$(dirname "$0")/../.."

case ${1:-} in
  -h | --help) sed -n '2,7s/^# \{0,1\}//p' "$0"; exit 0 ;;
esac
folder=${1:-build/sysroot-arm64}

as_root() { if [[ $(id -u) -eq 0 ]]; then "$@"; else sudo "$@"; fi; }

packages=(mmdebstrap g++-aarch64-linux-gnu qemu-user-static)
dpkg-query -W "${packages[@]}" >/dev/null 2>&1 ||
  as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "${packages[@]}"

if [[ -e $folder/usr/include/libcamera ]]; then
  echo "$folder is there already"
  exit 0
fi
libraries=(
  libc6-dev libstdc++-12-dev libeigen3-dev libhwy-dev libopencv-dev libjpeg-dev
  libpng-dev libcivetweb-dev libcli11-dev libtoml11-dev nlohmann-json3-dev libgtest-dev
  libgmock-dev libumockdev-dev libudev-dev libsystemd-dev libgpiod-dev libcamera-dev
)
sources=()
for file in /etc/apt/sources.list /etc/apt/sources.list.d/*.list /etc/apt/sources.list.d/*.sources; do
  [[ -s $file ]] && sources+=("$file")
done
mkdir -p "$(dirname "$folder")"
release=$(. /etc/os-release && echo "$VERSION_CODENAME")
as_root mmdebstrap --variant=extract --architectures=arm64 \
  --include="$(IFS=,; echo "${libraries[*]}")" "$release" "$folder" "${sources[@]}"
# OpenCV's needs these by name, which `update-alternatives` would link.
triplet=usr/lib/aarch64-linux-gnu
for library in blas lapack; do
  as_root ln -sf "$library/lib$library.so.3" "$folder/$triplet/lib$library.so.3"
done
