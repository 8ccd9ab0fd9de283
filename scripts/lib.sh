# Shared by the scripts here; sourced, not run. Everything it says goes to stderr: stdout belongs to the program started.

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
program_rooms="common;can_protocol;module_fw;supervisor;sim_vcan;cli"
all_rooms="$program_rooms;bindings;examples;tests"

say() { printf '%s\n' "$*" >&2; }
die() {
  say "$(basename "$0"): $*"
  exit 1
}

# usage: prints the comment at the top of the calling script.
usage() { sed -n '2,/^$/{s/^# \{0,1\}//p}' "$0"; }

# quietly WHAT COMMAND...: runs it with its output in build/WHAT.log, which is shown when it fails. On a terminal the
# command writes to the terminal, so that a long build shows its progress.
quietly() {
  local log="$root/build/$1.log"
  shift
  mkdir -p "$root/build"
  if [[ -t 2 ]]; then
    "$@" >&2 || die "failed: $*"
  elif ! "$@" >"$log" 2>&1; then
    tail -n 40 "$log" >&2
    die "failed: $* (all of its output: $log)"
  fi
}

# configure PRESET ROOMS: writes build/PRESET unless it is there with at least these rooms.
configure() {
  local preset=$1 rooms=$2 cache="$root/build/$1/CMakeCache.txt"
  if [[ -f "$root/build/$preset/build.ninja" ]] && grep -qF "MRR_ROOMS:STRING=$rooms" "$cache"; then return; fi
  (cd "$root" && quietly "configure-$preset" cmake --preset "$preset" -DMRR_ROOMS="$rooms")
}

# build PRESET [TARGET...]
build() {
  local preset=$1
  shift
  local targets=()
  if (($# > 0)); then targets=(--target "$@"); fi
  # Nothing to do is done without a word; a first build is announced, because it takes minutes.
  if (cd "$root" && ninja -C "build/$preset" -n ${1:+"$@"} 2>/dev/null | grep -q 'no work to do'); then return; fi
  say "building ($preset); the first time takes some minutes"
  (cd "$root" && quietly "build-$preset" cmake --build --preset "$preset" --parallel "$(nproc)" "${targets[@]}")
}

# cxx_files: all C++ files of the project, NUL separated.
cxx_files() {
  (cd "$root" && find . \( -path ./build -o -path ./.venv -o -path ./out -o -path ./.git \) -prune -o \
    \( -name '*.h' -o -name '*.cpp' \) -type f -print0 | sort -z)
}
