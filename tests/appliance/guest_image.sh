#!/usr/bin/env bash
# Makes the disk a guest boots from: Debian of this machine's release with what lcdm depends on, but
# without lcdm itself, and beside it the kernel, its initial RAM disk and a key for ssh.
#
#   tests/appliance/guest_image.sh PACKAGE.deb FOLDER ARCHITECTURE
#
# Made once for what the package depends on and this script says; needs root, but neither loop
# devices nor KVM, so that it works in a bare container. About 1.2 GB in FOLDER. For another processor
# than this machine's its packages' scripts run under QEMU's emulator, which takes several times as long.
set -euo pipefail

package=$(realpath "$1")
mkdir -p "$2"
folder=$(realpath "$2") architecture=$3
cd "$(dirname "$0")"
log=$folder/image.log

# Names alone: the versions are checked when the package is installed in the guest.
dependencies=$(dpkg-deb -f "$package" Depends Pre-Depends |
  sed 's/^[A-Za-z-]*: //; s/([^)]*)//g; s/|[^,]*//g' | tr ',' '\n' | tr -d ' ' | sort -u | grep .)
key=$({ echo "$dependencies"; cat guest_image.sh; } | sha256sum | cut -c1-16)
[[ -e $folder/$key.done ]] && exit 0

packages=(
  systemd-sysv udev dbus kmod netbase iproute2 procps openssh-server "linux-image-$architecture"
  initramfs-tools zstd v4l-utils gpiod libcamera-tools libcamera-ipa udhcpc curl ca-certificates
)
sources=()
for file in /etc/apt/sources.list /etc/apt/sources.list.d/debian*.sources; do
  [[ -s $file ]] && sources+=("$file")
done
root=$(mktemp -d "$folder/root.XXXX")
trap 'rm -rf "$root"' EXIT

# Kernel modules that no check uses are half the disk.
no_documents=(man doc locale info)
no_modules=(
  drivers/gpu drivers/net/ethernet drivers/net/wireless drivers/infiniband drivers/scsi
  drivers/iio drivers/hid drivers/isdn drivers/staging drivers/mtd drivers/message fs/xfs fs/btrfs
  fs/ocfs2 fs/ceph fs/smb fs/nfs fs/f2fs fs/gfs2 fs/jfs fs/reiserfs sound
)
# Nobody needs this disk after a crash while it is made.
exclude=(--dpkgopt=force-unsafe-io)
for name in "${no_documents[@]}"; do exclude+=(--dpkgopt="path-exclude=/usr/share/$name/*"); done
for name in "${no_modules[@]}"; do
  exclude+=(--dpkgopt="path-exclude=/lib/modules/*/kernel/$name/*")
done

[[ -e $folder/key ]] || ssh-keygen -q -t ed25519 -N '' -C guest -f "$folder/key"

# Only what finds the disk goes into the initial RAM disk: that is what boots fast when emulated. Said
# before the kernel is installed, which makes it: with all drivers that takes long for another processor.
small_initrd='cd "$1" && mkdir -p etc/initramfs-tools/conf.d usr/share/initramfs-tools/modules.d &&
  printf "MODULES=list\nBUSYBOX=n\nFSTYPE=ext4\n" >etc/initramfs-tools/conf.d/guest &&
  printf "virtio_pci\nvirtio_blk\next4\n" >usr/share/initramfs-tools/modules.d/guest'

echo "guest image: packages, disk (log: $log)"
mmdebstrap --mode=root --variant=minbase --architectures="$architecture" --aptopt='Apt::Install-Recommends "false"' \
  "${exclude[@]}" --include="$(IFS=,; echo "${packages[*]}"),$(paste -sd, <<<"$dependencies")" \
  --essential-hook="$small_initrd" --customize-hook='copy-in guest_files/. /' \
  --customize-hook='chroot "$1" systemctl enable systemd-networkd ssh' \
  "$(. /etc/os-release && echo "$VERSION_CODENAME")" "$root" "${sources[@]}" >"$log" 2>&1 ||
  { tail -20 "$log" >&2; exit 1; }

install -D -m 600 "$folder/key.pub" "$root/root/.ssh/authorized_keys"
echo guest >"$root/etc/hostname"
: >"$root/etc/machine-id"
# Timers and services of a machine that lives for long, which only take time from the checks.
for unit in apt-daily.timer apt-daily-upgrade.timer dpkg-db-backup.timer fstrim.timer \
  systemd-networkd-wait-online.service e2scrub_all.timer e2scrub_reap.service systemd-timesyncd.service getty@tty1.service; do
  ln -sf /dev/null "$root/etc/systemd/system/$unit"
done
cp "$root"/boot/vmlinuz-* "$folder/vmlinuz"
cp "$root"/boot/initrd.img-* "$folder/initrd"
ls "$root/lib/modules" >"$folder/kernel"
rm -f "$folder/disk.ext4"
mke2fs -q -t ext4 -d "$root" "$folder/disk.ext4" 3G >>"$log" 2>&1
rm -f "$folder"/*.done
touch "$folder/$key.done"
