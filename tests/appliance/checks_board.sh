# What hangs on the board: GPIO lines, the USB cable, cameras behind libcamera. Sourced by run.sh.

# Drivers that Debian does not build. Without depmod, which takes minutes here; what vimc needs is
# loaded with vivid.
board_modules() {
  local modules
  modules=$(tests/appliance/guest_modules.sh "$guest" "$architecture" board) || return
  tar -c -C "$modules" . | on_guest 'tar -x -C /root && insmod /root/gpio-sim.ko &&
    modprobe vivid && insmod /root/vimc.ko' >&2
}

gpio_chip=/sys/kernel/config/gpio-sim/board
gpio_set_up() {
  on_guest "mkdir -p $gpio_chip/bank/line{0,1,2} && cd $gpio_chip &&
    echo 3 >bank/num_lines && echo lcdm-light >bank/line0/name && echo lcdm-button >bank/line1/name &&
    echo lcdm-heartbeat >bank/line2/name && echo 1 >live" >&2 || return
  gpio=$(on_guest "echo /sys/devices/platform/\$(cat $gpio_chip/dev_name)/\$(cat $gpio_chip/bank/chip_name)")
  gpio_service
  within 60 depth_flows
}
# gpio_service [LIGHT]
gpio_service() {
  set_service "LCDM_GPIO_LIGHT=${1:-lcdm-light}" LCDM_GPIO_BUTTON=lcdm-button \
    LCDM_GPIO_HEARTBEAT=lcdm-heartbeat
}

# line_samples LINE: its level, 60 times in 3 s.
line_samples() {
  on_guest "for i in \$(seq 60); do cat $gpio/sim_gpio$1/value; sleep 0.05; done | tr -d '\n'"
}
press_button() {
  on_guest "echo pull-up >$gpio/sim_gpio1/pull; sleep $1; echo pull-down >$gpio/sim_gpio1/pull"
}

# Streaming is steady, waiting for a camera a flash every two seconds; unlit when the service ends.
gpio_light() {
  local streaming waiting stopped
  streaming=$(line_samples 0)
  unplug
  within 20 state_is 'waiting for camera' >&2
  waiting=$(line_samples 0)
  plug_in
  on_guest systemctl stop lcdm
  stopped=$(line_samples 0)
  on_guest systemctl start lcdm
  echo "lit of 60 looks: streaming $(ones "$streaming"), waiting $(ones "$waiting"), stopped $(ones "$stopped")"
  within 60 depth_flows >&2 || return
  (($(ones "$streaming") == 60 && $(ones "$stopped") == 0)) &&
    (($(ones "$waiting") > 0 && $(ones "$waiting") < 20))
}
ones() { tr -cd 1 <<<"$1" | wc -c; }

gpio_heartbeat() {
  local levels
  levels=$(line_samples 2)
  echo "high in $(ones "$levels") of 60 looks"
  (($(ones "$levels") > 10 && $(ones "$levels") < 50))
}

# A supervisor outside sees the beat stand still while the device is not alive, until the service that
# systemd starts then beats.
gpio_heartbeat_stops() {
  local levels
  freeze_inference || return
  within 60 state_is fault >&2 || return
  levels=$(line_samples 2)
  echo "fault: high in $(ones "$levels") of 60 looks"
  within 60 depth_flows >&2 && gpio_heartbeat >&2 && [[ $levels =~ ^(0{60}|1{60})$ ]]
}

# The service ends while its heartbeat is high and its light, here active when low, is lit: both lines are
# driven to their safe level. A simulated line that nobody holds shows its pull, whatever it was driven to
# before: the kernel's trace has that.
gpio_ends_safe() {
  local levels
  gpio_service '!lcdm-light'
  within 60 depth_flows >&2 || return
  levels=$(on_guest "cd /sys/kernel/tracing && : >trace && echo 1 >events/gpio/gpio_value/enable || exit
    until grep -q 0 $gpio/sim_gpio2/value; do :; done; until grep -q 1 $gpio/sim_gpio2/value; do :; done
    systemctl stop lcdm; echo 0 >events/gpio/gpio_value/enable; systemctl start lcdm
    first=\$(cat $gpio/../gpio/gpiochip*/base)
    for line in \$first \$((first + 2)); do sed -n \"s/.*gpio_value: \$line set //p\" trace | tail -1; done | paste -sd' '")
  echo "light (active when low) and heartbeat at the end: $levels"
  within 60 depth_flows >&2 && [[ $levels == '1 0' ]]
}

recording_is() { [[ $(status .recording.on) == "$1" ]]; }
gpio_button() {
  press_button 0.4
  within 10 recording_is true >&2 || return
  press_button 0.4
  within 10 recording_is false
}

# Held for 3 s: the machine powers itself off.
gpio_power_off() {
  local begin
  gpio_service
  within 60 depth_flows >&2 || return
  begin=$EPOCHREALTIME
  press_button 4 || true
  within 90 guest_is_off >&2 || return
  hang_up
  seconds "$(elapsed_ms "$begin")"
}
guest_is_off() { ! kill -0 "$guest_pid" 2>/dev/null; }

# The network over the cable is enabled, with a controller that the next boot brings.
usb_is_enabled() {
  on_guest 'printf "dummy_hcd\ncdc_ncm\n" >/etc/modules-load.d/usb.conf && systemctl enable lcdm-usb' >&2
}
# The page as shipped answers over the cable after a boot, without anybody's doing. No camera is there yet.
# Off again afterwards: other checks begin without it.
usb_comes_with_boot() {
  local rc=0
  { within 60 cable_up_since && usb_host_gets_address && within 60 usb_page_answers /; } >&2 || rc=1
  echo "up $(($(cable_up_since) / 1000000)) s after the kernel's first moment, $(on_guest systemctl show lcdm-usb -p NRestarts --value) tries more"
  on_guest 'systemctl disable --now lcdm-usb && rm /etc/modules-load.d/usb.conf' >&2 || rc=1
  return "$rc"
}

# The host's end of the cable is a network name space of the same guest. The service listens as shipped
# (and where we reach it), and is up before the network is: the address that it waited for is one it listens
# on afterwards. Before there is a controller the unit fails, and does not try again and again.
host_end='ip netns exec host'
usb_network() {
  on_guest '! systemctl start lcdm-usb && systemctl is-failed --quiet lcdm-usb' >&2 || return
  set_token || return
  set_service LCDM_HTTP_TOKEN_FILE=/etc/lcdm/token \
    "LCDM_HTTP_LISTEN=10.0.2.15,$(on_guest "sed -n 's/^listen = \"\(.*\)\"/\1/p' /etc/lcdm/lcdm.toml")"
  within 60 depth_flows >&2 || return
  on_guest 'journalctl -b -u lcdm | grep -q "this machine does not have 192.168.58.1 now: waiting for it"' || return
  on_guest 'modprobe dummy_hcd && modprobe cdc_ncm && systemctl start lcdm-usb' >&2 || return
  usb_host_gets_address >&2 || return
  within 60 usb_page_answers >&2 || return
  on_guest "$host_end ip -4 -o address show dev cable | grep -o '192[0-9.]*/24'"
}
# usb_page_answers [PATH]
usb_page_answers() { on_guest "$host_end curl -sf --max-time 5 http://192.168.58.1:8080${1:-/healthz}"; }
usb_host_gets_address() {
  on_guest 'for i in $(seq 60); do
      link=$(ip -o link | sed -n "s/^[0-9]*: \([^:]*\):.*02:1c:d3:00:00:02.*/\1/p")
      [ -z "$link" ] || break; sleep 0.5
    done
    ip netns add host 2>/dev/null; ip link set "$link" down; ip link set "$link" name cable netns host &&
      ip -n host link set cable up && ip netns exec host udhcpc -i cable -n -q -t 20 -T 2'
}
usb_control_needs_the_token() {
  local codes post="$host_end curl -s -o /dev/null -w '%{http_code} ' --max-time 20 -X POST http://192.168.58.1:8080/record/stop"
  codes=$(on_guest "$post; $post -H 'Authorization: Bearer wrong'; $post -H 'Authorization: Bearer $token'")
  echo "without, with another, with the token: $codes"
  [[ $codes == '401 401 200 ' ]]
}
# Without an address the gadget is no use: it is taken back, and the controller is free. The unit tries
# again until there is one.
usb_failed_up() {
  on_guest 'systemctl stop lcdm-usb && cd /run/systemd/system && mkdir -p /root/blind lcdm-usb.service.d &&
    ln -sf /bin/true /root/blind/ip &&
    printf "[Service]\nEnvironment=PATH=/root/blind:$PATH\n" >lcdm-usb.service.d/blind.conf && systemctl daemon-reload &&
    ! systemctl start lcdm-usb && [ ! -e /sys/kernel/config/usb_gadget/lcdm ] && rm /root/blind/ip' >&2 || return
  within 30 cable_up_since || return
  on_guest 'rm -r /run/systemd/system/lcdm-usb.service.d && systemctl daemon-reload' >&2
}

# Down leaves nothing, twice is no mistake, and up makes it anew.
usb_down_and_up() {
  on_guest 'systemctl stop lcdm-usb && [ ! -e /sys/kernel/config/usb_gadget/lcdm ] &&
    /usr/libexec/lcdm/usb-gadget down && systemctl start lcdm-usb &&
    /usr/libexec/lcdm/usb-gadget up' >&2 || return
  usb_host_gets_address >&2 || return
  within 60 usb_page_answers >&2 || return
  # A service that listens there already is left alone.
  on_guest 'before=$(systemctl show lcdm -p MainPID); systemctl restart lcdm-usb; sleep 3
    [ "$before" = "$(systemctl show lcdm -p MainPID)" ]'
}

# In place of Jetson's two programs stand ones that write down how they were called. As the real one,
# this jetson_clocks stores over no file and restores from none that is missing.
jetson_power() {
  on_guest 'cat >/usr/sbin/nvpmodel && cp /usr/sbin/nvpmodel /usr/bin/jetson_clocks &&
    chmod +x /usr/sbin/nvpmodel /usr/bin/jetson_clocks' <<'END'
#!/bin/sh
echo "${0##*/}" "$@" >>/run/jetson.log
case $1 in
  --store) [ ! -e "$2" ] && echo clocks >"$2" ;;
  --restore) [ -s "$2" ] ;;
esac
END
  on_guest 'for i in 1 2; do systemctl start lcdm-jetson-power && systemctl stop lcdm-jetson-power || exit; done' >&2 || return
  on_guest 'rm /usr/sbin/nvpmodel /usr/bin/jetson_clocks; cat /run/jetson.log' >"$work/jetson.log" || return
  cat "$work/jetson.log" >&2
  diff - "$work/jetson.log" >&2 <<'END'
nvpmodel -m 0
jetson_clocks --store /run/lcdm-jetson-power/clocks
jetson_clocks
jetson_clocks --restore /run/lcdm-jetson-power/clocks
nvpmodel -m 0
jetson_clocks --store /run/lcdm-jetson-power/clocks
jetson_clocks
jetson_clocks --restore /run/lcdm-jetson-power/clocks
END
}

libcamera_streams() {
  local id
  id=$(on_guest 'cam -l 2>/dev/null' | sed -n 's/^[0-9]*: .*(\(.*\)).*/\1/p' | head -1)
  [[ -n $id ]] || return
  set_service "LCDM_CAMERA_SOURCE=libcamera:$id"
  within 90 depth_flows >&2 || return
  status .source.description
}
