#!/usr/bin/env bash
# Builds the kernel's test drivers that Debian leaves out, for the kernel of the guest's image:
# gpio-sim (simulated GPIO lines) and vimc (a camera that only libcamera makes sense of).
#
#   tests/appliance/guest_modules.sh FOLDER        FOLDER is the image's
#
# The last line printed is the folder in it that then holds gpio-sim.ko and vimc.ko.
#
# From Debian's own kernel source and headers, which it installs (about 200 MB).
set -euo pipefail
folder=$(realpath "$1")

as_root() { if [[ $(id -u) -eq 0 ]]; then "$@"; else sudo "$@"; fi; }
packages=(linux-headers-amd64 linux-source xz-utils)
dpkg-query -W "${packages[@]}" >/dev/null 2>&1 ||
  as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "${packages[@]}" >&2

# The headers' version must be the image's: a module of another does not load.
version=$(strings "$folder/vmlinuz" | sed -n 's/^\(6[^ ]*-amd64\) .*/\1/p' | head -1)
headers=/usr/src/linux-headers-$version
[[ -d $headers ]] || { echo "guest_modules: no $headers: rebuild the image, it is older" >&2; exit 1; }
modules=$folder/modules-$version
[[ ! -e $modules/vimc.ko ]] || { echo "$modules"; exit 0; }

source=$(mktemp -d)
trap 'rm -rf "$source"' EXIT
tar -xf /usr/src/linux-source-*.tar.xz -C "$source" --strip-components=1 --wildcards \
  '*/drivers/gpio/gpio-sim.c' '*/drivers/gpio/gpiolib*.h' '*/kernel/irq/irq_sim.c' \
  '*/drivers/media/test-drivers/vimc'

# gpio-sim needs the simulated interrupts, which are not a module: they become part of it.
build=$source/build
mkdir "$build"
cp "$source"/drivers/gpio/gpiolib*.h "$build"
cp "$source/drivers/gpio/gpio-sim.c" "$build/gpio-sim-main.c"
sed '/^EXPORT_SYMBOL/d; s/handle_simple_irq(irq_to_desc(\(.*\)));/generic_handle_irq(\1);/' \
  "$source/kernel/irq/irq_sim.c" >"$build/irq_sim.c"
cp -r "$source/drivers/media/test-drivers/vimc" "$build/vimc"
cat >"$build/Kbuild" <<'END'
obj-m += gpio-sim.o vimc/
gpio-sim-y := gpio-sim-main.o irq_sim.o
END
make -s -C "$headers" M="$build" CONFIG_VIDEO_VIMC=m modules >&2
mkdir -p "$modules"
cp "$build/gpio-sim.ko" "$build/vimc/vimc.ko" "$modules/"
echo "$modules"
