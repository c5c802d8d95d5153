#!/usr/bin/env bash
# Builds lcdm and makes a Debian package of it, for the system this runs on.
#
#   ./package.sh                  build/package/lcdm_VERSION_ARCHITECTURE.deb
#   ./package.sh --preset NAME    of what that CMake preset builds (default: release; `arm64` is for
#                                 another processor, and wants tests/arm64/sysroot.sh run before)
#
# A package made on Debian 12 does not install on Ubuntu 22.04, nor the other way round: each has its
# own versions of the libraries. Installs what is missing. The last line printed is the package.
set -euo pipefail
cd "$(dirname "$0")"

preset=release
case ${1:-} in
  '') ;;
  --preset) preset=${2:?"package.sh: --preset wants a name"} ;;
  -h | --help) sed -n '2,9s/^# \{0,1\}//p' "$0"; exit 0 ;;
  *) echo "package.sh: unknown option '$1': see ./package.sh --help" >&2; exit 2 ;;
esac

systemd/install-packages.sh run package
[[ -f build/$preset/build.ninja ]] || cmake --preset "$preset"
cmake --build "build/$preset" --target lcdm

# A later commit is a later version; without git, the plain one.
version=$(sed -n 's/^project(lcdm VERSION \([0-9.]*\).*/\1/p' CMakeLists.txt)
time=$(git log -1 --format=%ct 2>/dev/null || stat -c %Y CHANGELOG.md)
. /etc/os-release
version+=+$(date -u -d "@$time" +%Y%m%d%H%M)~$ID$VERSION_ID

# dpkg wants a folder `debian` at the top of a tree: it gets one of its own.
tree=build/package/tree
rm -rf "$tree"
mkdir -p "$tree"
cp -r systemd/debian "$tree/debian"
cat >"$tree/debian/changelog" <<END
lcdm ($version) unstable; urgency=medium

  * What changed stands in CHANGELOG.md.

 -- LCDM-Mono maintainers <maintainers@lcdm-mono.invalid>  $(date -u -R -d "@$time")
END
log=build/package/build.log
architecture=$(dpkg --print-architecture) libraries=
if [[ $preset == arm64 ]]; then
  architecture=arm64
  sysroot=$PWD/build/sysroot-arm64
  libraries=$sysroot/lib/aarch64-linux-gnu:$sysroot/usr/lib/aarch64-linux-gnu
  # dpkg does not know those libraries, but their like for this machine, of the same release.
  cat /var/lib/dpkg/info/*:"$(dpkg --print-architecture)".shlibs >"$tree/debian/shlibs.local"
fi
(cd "$tree" && LCDM_BUILD=$OLDPWD/build/$preset LCDM_LIBRARIES=$libraries \
  dpkg-buildpackage -a "$architecture" -b -us -uc) >"$log" 2>&1 ||
  { tail -30 "$log" >&2; exit 1; }
ls "build/package/lcdm_${version}_$architecture.deb"
