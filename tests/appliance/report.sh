# One line for every check and a table at the end. Sourced.

checks=()
failures=0
skipped=0
cannot=77  # the exit status of a check that this guest cannot have; its last line says why

# check NAME COMMAND...: PASS, FAIL or SKIP by the command's exit status, beside the last line it
# printed and the seconds it took. What it says on standard error goes to $work/checks.log.
check() {
  local name=$1 begin=$SECONDS result=PASS rc=0 detail
  shift
  printf '\n=== %s\n' "$name" >>"$work/checks.log"
  "$@" >"$work/detail" 2>>"$work/checks.log" || rc=$?
  detail=$(tail -1 "$work/detail")
  case $rc in
    0) ;;
    "$cannot") result=SKIP skipped=$((skipped + 1)) ;;
    *) result=FAIL failures=$((failures + 1)) ;;
  esac
  local line
  line=$(printf '%-4s  %-46s %4d s  %s' "$result" "$name" $((SECONDS - begin)) "$detail")
  checks+=("$line")
  echo "$line"
}

print_checks() {
  printf '\n%-4s  %-46s %6s  %s\n' '' 'check' 'took' 'found'
  printf '%s\n' "${checks[@]}"
  echo "$((${#checks[@]} - failures - skipped)) of ${#checks[@]} passed, $failures failed, $skipped skipped"
}

# within SECONDS COMMAND...: repeats it until it succeeds and prints how many seconds that took. The
# limit is an amd64 guest's.
within() {
  local limit=$(($1 * patience)) begin=$EPOCHREALTIME
  shift
  while ! "$@" >/dev/null 2>&1; do
    (($(elapsed_ms "$begin") < limit * 1000)) || return 1
    sleep 0.2
  done
  seconds "$(elapsed_ms "$begin")"
}

elapsed_ms() { echo $(((${EPOCHREALTIME/[.,]/} - ${1/[.,]/}) / 1000)); }
seconds() { printf '%d.%d s\n' $(($1 / 1000)) $(($1 % 1000 / 100)); }
