#!/usr/bin/env bash
# Builds kernel drivers that Debian leaves out, for the kernel of a guest's image.
#
#   tests/appliance/guest_modules.sh FOLDER ARCHITECTURE SET        FOLDER is the image's
#
#     board       gpio-sim (simulated GPIO lines) and vimc (a camera that only libcamera makes sense of)
#     loopback    v4l2loopback (a camera whose frames a program writes)
#
# The last line printed is the folder in it that then holds the set's modules.
#
# From Debian's own sources and kernel headers. Those of this machine's own processor, and the kernel's
# source for `board` (about 200 MB), are installed.
set -euo pipefail
folder=$(realpath "$1") architecture=$2 set=$3
version=$(<"$folder/kernel")
modules=$folder/modules-$version-$set
[[ ! -e $modules/done ]] || { echo "$modules"; exit 0; }

build=$(mktemp -d)
trap 'rm -rf "$build"' EXIT
native=false
[[ $architecture != "$(dpkg --print-architecture)" ]] || native=true

as_root() { if [[ $(id -u) -eq 0 ]]; then "$@"; else sudo "$@"; fi; }
install_packages() {
  dpkg-query -W "$@" >/dev/null 2>&1 ||
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "$@" >&2
}

# unpack PACKAGE: into $build/packages, for the guest's processor, without installing anything. The lists
# of another processor's packages are apt's, but kept here.
unpack() {
  local state=$build/apt apt
  mkdir -p "$state/lists/partial" "$build/packages"
  apt=(apt-get -q -o "APT::Architecture=$architecture" -o "APT::Architectures=$architecture"
    -o APT::Sandbox::User=root -o "Dir::Cache=$state" -o "Dir::State::lists=$state/lists")
  (cd "$build/packages" && as_root "${apt[@]}" update && as_root "${apt[@]}" download "$1" &&
    dpkg-deb -x "$1"_*.deb .) >&2
}

# The headers' version must be the image's: a module of another does not load.
get_headers() {
  local kbuild
  if $native; then
    install_packages "linux-headers-$version"
    headers=/usr/src/linux-headers-$version
  else
    kbuild=linux-kbuild-$(cut -d. -f1,2 <<<"$version")
    install_packages "linux-headers-${version%-*}-common" "$kbuild" g++-aarch64-linux-gnu
    unpack "linux-headers-$version"
    headers=$build/packages/usr/src/linux-headers-$version
    mkdir -p "$build/packages/usr/lib"
    ln -s "/usr/lib/$kbuild" "$build/packages/usr/lib/"  # where the headers look for it
  fi
}
# make_modules FOLDER [OPTION...]
make_modules() {
  local cross=()
  $native || cross=(DEB_BUILD_ARCH="$(dpkg --print-architecture)" DEB_HOST_ARCH="$architecture"
    DEB_HOST_GNU_TYPE=aarch64-linux-gnu CROSS_COMPILE=aarch64-linux-gnu-)
  make -s -C "$headers" M="$1" "${cross[@]}" "${@:2}" modules >&2
}

# gpio-sim needs the simulated interrupts, which are not a module: they become part of it.
build_board() {
  local source=$build/source board=$build/board
  install_packages linux-source xz-utils
  mkdir -p "$source" "$board"
  tar -xf /usr/src/linux-source-*.tar.xz -C "$source" --strip-components=1 --wildcards \
    '*/drivers/gpio/gpio-sim.c' '*/drivers/gpio/gpiolib*.h' '*/kernel/irq/irq_sim.c' \
    '*/drivers/media/test-drivers/vimc'
  cp "$source"/drivers/gpio/gpiolib*.h "$board"
  cp "$source/drivers/gpio/gpio-sim.c" "$board/gpio-sim-main.c"
  sed '/^EXPORT_SYMBOL/d; s/handle_simple_irq(irq_to_desc(\(.*\)));/generic_handle_irq(\1);/' \
    "$source/kernel/irq/irq_sim.c" >"$board/irq_sim.c"
  cp -r "$source/drivers/media/test-drivers/vimc" "$board/vimc"
  cat >"$board/Kbuild" <<'END'
obj-m += gpio-sim.o vimc/
gpio-sim-y := gpio-sim-main.o irq_sim.o
END
  make_modules "$board" CONFIG_VIDEO_VIMC=m
  cp "$board/gpio-sim.ko" "$board/vimc/vimc.ko" "$modules/"
}

build_loopback() {
  unpack v4l2loopback-dkms
  cp -r "$build"/packages/usr/src/v4l2loopback-* "$build/loopback"
  echo 'obj-m += v4l2loopback.o' >"$build/loopback/Kbuild"
  make_modules "$build/loopback"
  cp "$build/loopback/v4l2loopback.ko" "$modules/"
}

mkdir -p "$modules"
get_headers
"build_$set"
touch "$modules/done"
echo "$modules"
