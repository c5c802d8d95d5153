#!/usr/bin/env bash
# Installs the Debian packages that a group of tasks needs, from the machine's own package sources.
#
#   systemd/install-packages.sh run          build and run lcdm (all a board needs)
#   systemd/install-packages.sh package      make a .deb of it
#   systemd/install-packages.sh test         run the tests and checks
#   systemd/install-packages.sh train        build lcdm-train (LibTorch; about 200 MB)
#
# Several groups may be given. Asks nothing; uses sudo when not root; does nothing, and needs no
# network, when everything is there.
set -euo pipefail

run=(
  build-essential cmake ninja-build pkg-config libeigen3-dev libhwy-dev libopencv-dev
  libjpeg-dev libpng-dev libcivetweb-dev libcli11-dev libtoml11-dev
  nlohmann-json3-dev libudev-dev libsystemd-dev libgpiod-dev
)
run_optional=(libcamera-dev)  # left out where the distribution has none
package=(debhelper)
test=(
  libgtest-dev libgmock-dev libumockdev-dev umockdev clang-format clang-tidy chromium
  fonts-dejavu-core git nodejs npm opencv-doc g++-11
  lintian mmdebstrap arch-test e2fsprogs openssh-client qemu-system-x86 qemu-system-arm qemu-utils curl jq
)
train=(libtorch-dev libopenblas0-pthread libgloo-dev libmatio-dev libhdf5-dev python3-torch)

usage() { sed -n '2,10s/^# \{0,1\}//p' "$0"; }

packages=()
optional=()
[[ $# -gt 0 ]] || { usage >&2; exit 2; }
for group in "$@"; do
  case $group in
    run) packages+=("${run[@]}"); optional+=("${run_optional[@]}") ;;
    package) packages+=("${package[@]}") ;;
    test) packages+=("${test[@]}") ;;
    train) packages+=("${train[@]}") ;;
    -h | --help) usage; exit 0 ;;
    *) echo "install-packages: unknown group '$group': use run, package, test or train" >&2; exit 2 ;;
  esac
done

installed() {
  dpkg-query -W -f '${db:Status-Status}' "$1" 2>/dev/null | grep -qx installed && return 0
  # Node.js from another source than the distribution brings npm inside the package nodejs.
  [[ $1 == npm ]] && command -v npm >/dev/null
}

missing=()
for package in "${packages[@]}"; do
  installed "$package" || missing+=("$package")
done
# Adds those optional packages that the package lists know to what is missing.
add_optional() {
  local package
  for package in "${optional[@]}"; do
    installed "$package" || ! apt-cache show "$package" >/dev/null 2>&1 || missing+=("$package")
  done
}
required=${#missing[@]}
[[ $required -gt 0 ]] || add_optional
[[ ${#missing[@]} -gt 0 ]] || exit 0

as_root() {
  if [[ $(id -u) -eq 0 ]]; then "$@"; else sudo "$@"; fi
}
if [[ $(id -u) -ne 0 ]] && ! command -v sudo >/dev/null; then
  echo "install-packages: run as root, or install sudo; missing: ${missing[*]}" >&2
  exit 1
fi

export DEBIAN_FRONTEND=noninteractive
as_root apt-get update -q
[[ $required -eq 0 ]] || add_optional
echo "Installing ${#missing[@]} packages: ${missing[*]}"
as_root env DEBIAN_FRONTEND=noninteractive \
  apt-get install -y -q --no-install-recommends "${missing[@]}"
