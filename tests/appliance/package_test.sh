#!/usr/bin/env bash
# Holds the package to what an installed device needs, without installing it.
#
#   tests/appliance/package_test.sh PACKAGE.deb
set -euo pipefail
package=$1
failures=0
fail() { echo "FAIL  $*" >&2; failures=$((failures + 1)); }

contents=$(dpkg-deb -c "$package" | awk '{print $6}')
for file in usr/bin/lcdm usr/share/lcdm/lcdm-xs.safetensors \
  usr/share/lcdm/lcdm-xxs.safetensors usr/share/lcdm/lcdm-xxs-open.safetensors \
  usr/share/lcdm/lcdm-xs-open.safetensors usr/libexec/lcdm/usb-gadget \
  etc/lcdm/lcdm.toml lib/systemd/system/lcdm.service lib/systemd/system/lcdm-poweroff.path \
  lib/systemd/system/lcdm-usb.service lib/udev/rules.d/70-lcdm.rules usr/lib/sysusers.d/lcdm.conf \
  usr/lib/tmpfiles.d/lcdm.conf usr/lib/systemd/system.conf.d/lcdm-watchdog.conf \
  usr/lib/systemd/network/70-lcdm-usb.network usr/share/doc/lcdm/copyright \
  usr/share/doc/lcdm/README.md usr/share/doc/lcdm/app.md usr/share/doc/lcdm/device.md \
  usr/share/doc/lcdm/weights.md; do
  grep -qx "./$file" <<<"$contents" || fail "no /$file"
done
# Nothing of a developer's machine, nothing where an administrator keeps things.
grep -E '^\./(home|root|opt|usr/local|var)/' <<<"$contents" && fail 'files that belong elsewhere'

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
dpkg-deb -R "$package" "$work"
grep -qx /etc/lcdm/lcdm.toml "$work/DEBIAN/conffiles" || fail 'the configuration is no conffile'
dpkg-deb -f "$package" Depends | grep -q 'libopencv-core' || fail 'libraries are no dependencies'

# 20 is an exposure of 2.0.
if (($(systemctl --version | sed -n '1s/^systemd \([0-9]*\).*/\1/p') >= 250)); then
  systemd-analyze security --offline=yes --threshold=20 --no-pager \
    "$work/lib/systemd/system/lcdm.service" >"$work/exposure" || fail 'exposure of lcdm.service'
  tail -1 "$work/exposure"
else
  echo 'exposure of lcdm.service: not looked at, which takes systemd 250'
fi
lintian --fail-on error "$package" || fail lintian
((failures == 0)) && echo "PASS  $(basename "$package")"
