# What systemd, the package and the machine do. Sourced by run.sh.

boots() { within 300 wait_guest 300; }

# The service as the checks run it: a network small enough for an emulated processor.
configure_service() {
  on_guest "mkdir -p /etc/systemd/system/lcdm.service.d
    cat >/etc/systemd/system/lcdm.service.d/guest.conf" <<'END'
[Service]
Environment=LCDM_MODEL_WIDTH=64 LCDM_MODEL_HEIGHT=64
Environment=LCDM_CAMERA_WIDTH=320 LCDM_CAMERA_HEIGHT=180 LCDM_CAMERA_FRAMES_PER_SECOND=5
Environment=LCDM_CAMERA_SOURCE=v4l2:/dev/video0
Environment=LCDM_HTTP_LISTEN=0.0.0.0
END
}

service_is_active() { on_guest systemctl is-active --quiet lcdm; }

package_installs() {
  configure_service
  to_guest "$package" /root/lcdm.deb
  on_guest 'dpkg -i /root/lcdm.deb' >&2
  on_guest 'systemctl is-enabled lcdm' >&2
  within 60 service_is_active
}
