# What differs between the processors a guest can have. Sourced.

# set_architecture NAME: a processor by Debian's name for it. Sets what the others read:
#   machine    QEMU for it, without KVM
#   console    its serial console
#   compiler   g++ for it
#   patience   how many times longer than amd64's every limit of time is
set_architecture() {
  architecture=$1
  case $1 in
    # Without fused multiply-adds, which are emulated in software: a frame takes an eighth of the time.
    amd64) machine=(qemu-system-x86_64 -M pc -cpu max,fma=off) console=ttyS0 compiler=g++ patience=1 ;;
    arm64)
      machine=(qemu-system-aarch64 -M virt,gic-version=3 -cpu cortex-a76) console=ttyAMA0
      compiler=aarch64-linux-gnu-g++ patience=3
      ;;
    *) echo "unknown architecture '$1': amd64 or arm64" >&2; return 2 ;;
  esac
}

# The guest's folder: image, kernel and key.
guest_folder() { echo "$PWD/build/appliance/guest-$architecture"; }

# make_package: for the guest's processor; the last line printed is the file.
make_package() {
  if [[ $architecture == "$(dpkg --print-architecture)" ]]; then
    ./package.sh
  else
    tests/arm64/sysroot.sh >&2 && ./package.sh --preset "$architecture"
  fi
}

# runs_here: whether programs for the guest's processor run on this machine, as the scripts of the
# packages in its image must. Where the kernel only has to be told of QEMU's emulator, it is told.
runs_here() {
  local table=/proc/sys/fs/binfmt_misc name=qemu-aarch64
  [[ $architecture == "$(dpkg --print-architecture)" || -e $table/$name ]] && return
  [[ -e /usr/lib/binfmt.d/$name.conf ]] || return
  [[ -e $table/register ]] || mount -t binfmt_misc none "$table" 2>/dev/null || return
  cat "/usr/lib/binfmt.d/$name.conf" >"$table/register" 2>/dev/null
}
