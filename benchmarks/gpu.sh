#!/usr/bin/env bash
# First contact, parity tests, benchmark and a whole training on this machine's GPU. Needs no network.
#
#   benchmarks/gpu.sh [PACK] [OUT]
#
# PACK  folder with the parts of gpu_pack.py's archive and its digest. It is unpacked into WORK, and
#       its packages come before those of PYTHON (torch, Numba and what else gpu-machine.txt names).
#       If left out or empty, only PYTHON's packages are used.
# OUT   folder for the results (the environment variable OUT, else runs/gpu): gpu.json, smoke.txt,
#       parity.txt, and of the training metrics.csv, evaluations.csv, config.json, provenance.json.
#
# Settings, as environment variables:
#   STAGES   stages to run, of "smoke parity bench train" (all). Each resumes an earlier call:
#            bench measures the rows that gpu.json lacks, train resumes from the last checkpoint.
#   DRY_RUN  1 to check and print each call's size, time and command, for a machine that takes a
#            limited amount per call; nothing is unpacked or measured.
#   STORE    folder for the parts on that machine (/tmp/pack), in the printed commands.
#   LIMIT_S  time limit per stage (480 s); train then saves and stops, call again to resume.
#   PYTHON   interpreter (python3).      WORK  folder for files kept between calls
#   DEVICE   cuda (default) or cpu.            (runs/gpu-work); remove it to start over.
#   TINY     1 for small sizes that only check that every stage runs.
#   BENCH_OPTIONS, TRAIN_OPTIONS   additional options of `knowarm bench gpu` and `knowarm train`.
set -euo pipefail

here=$(cd "$(dirname "$0")/.." && pwd)
PACK=${1:-} OUT=${2:-${OUT:-$here/runs/gpu}} WORK=${WORK:-$here/runs/gpu-work}
PYTHON=${PYTHON:-python3} DEVICE=${DEVICE:-cuda} TINY=${TINY:-} LIMIT_S=${LIMIT_S:-480} DRY_RUN=${DRY_RUN:-}
STORE=${STORE:-/tmp/pack}
STAGES=${STAGES-smoke parity bench train}
experiment=irb120-full-ppo
run=$WORK/runs/$experiment/0
TOTAL_STEPS=70000000 BENCH_ROWS="256 1024 4096 16384" BENCH_SECONDS=5

fail() { echo "gpu.sh: $*" >&2; exit 1; }

for stage in $STAGES; do
  case $stage in smoke | parity | bench | train) ;; *) fail "unknown stage '$stage'; the stages are smoke, parity, bench, train." ;; esac
done
case $DEVICE in cpu | cuda) ;; *) fail "DEVICE must be cuda or cpu, got '$DEVICE'." ;; esac
[ -z "$PACK" ] || [ -d "$PACK" ] || fail "the folder $PACK does not exist."

# The parts of the archive in PACK, or in one folder per transfer below it, in order.
parts=()
if [ -n "$PACK" ]; then
  mapfile -t parts < <(find "$PACK" -name 'site.tar.xz.*of*' -printf '%f %p\n' | sort | cut -d' ' -f2-)
  [ ${#parts[@]} -gt 0 ] || fail "there is no part of an archive (site.tar.xz.1of2) in $PACK."
fi

# Largest file of PACK, largest call with the checkout, longest time of all calls, and guesses of the
# times of a transfer, of unpacking and of training.
PART_BYTES=48000000 CALL_BYTES=67108864 TOTAL_S=1800 TRANSFER_S=60 UNPACK_S=30 STEPS_PER_S=200000

# Print the seconds that a stage will take. Nothing has been measured on a GPU: these are guesses
# from the CPU device and from the target speeds.
estimate() {
  case $1 in
    smoke) echo 90 ;;
    parity) echo 240 ;;
    bench) echo $((15 + $(wc -w <<< "$BENCH_ROWS") * (2 * BENCH_SECONDS + 20))) ;;
    train) echo $((60 + TOTAL_STEPS / STEPS_PER_S)) ;;
  esac
}

# Print and check one call: bytes of the pack that travel, seconds, command.
calls=0 total=0
call() {
  local bytes=$(($1 + checkout))
  calls=$((calls + 1)) total=$((total + $2))
  echo "call $calls: $((bytes / 1000)) kB, about $2 s: $3"
  [ $bytes -le $CALL_BYTES ] || fail "call $calls has more than $((CALL_BYTES / 1000)) kB."
  [ "$2" -le "$LIMIT_S" ] || fail "call $calls takes longer than LIMIT_S=$LIMIT_S s."
}

# Print what a machine that takes a limited amount per call would be asked for. The checkout travels
# with each call. The first stage runs in the call that brings the last part.
dry_run() {
  local part size store='' command run='' bytes=0 seconds=0
  checkout=$(cd "$here" && git ls-files -z --cached --others --exclude-standard 2> /dev/null |
    xargs -0 -r stat -c %s 2> /dev/null | awk '{sum += $1} END {print sum + 0}')
  echo "the checkout: $((checkout / 1000)) kB"
  [ "$DEVICE" = cuda ] || run="DEVICE=$DEVICE "
  run+="benchmarks/gpu.sh${PACK:+ $STORE}"
  for part in "${parts[@]}"; do
    size=$(stat -c %s "$part")
    echo "${part##*/}: $((size / 1000)) kB"
    [ "$size" -le $PART_BYTES ] || fail "${part##*/} has more than $((PART_BYTES / 1000000)) MB."
    [ -z "$store" ] || call "$bytes" "$seconds" "$store"
    store="mkdir -p $STORE && cp ${part%/*}/* $STORE" bytes=$size seconds=$TRANSFER_S
  done
  for stage in $STAGES; do
    command="STAGES=$stage $run" seconds=$((seconds + $(estimate "$stage")))
    [ -z "$store" ] || command="$store && $command" seconds=$((seconds + UNPACK_S))
    call "$bytes" "$seconds" "$command"
    store='' bytes=0 seconds=0
  done
  [ -z "$store" ] || call "$bytes" "$seconds" "$store"
  echo "$calls calls, about $((total / 60)) minutes"
  [ $total -le $TOTAL_S ] || fail "this is more than $((TOTAL_S / 60)) minutes."
}
if [ -n "$DRY_RUN" ]; then
  dry_run
  exit
fi

mkdir -p "$OUT" "$WORK"
OUT=$(cd "$OUT" && pwd) WORK=$(cd "$WORK" && pwd) run=$WORK/runs/$experiment/0

# Copy the results also if a later stage fails.
publish() {
  for file in "$WORK"/gpu.json "$WORK"/{smoke,parity}.txt "$run"/{metrics,evaluations}.csv "$run"/{config,provenance}.json; do
    [ ! -f "$file" ] || cp "$file" "$OUT/"
  done
}
trap publish EXIT

# Unpack the archive, unless an earlier call did. Its packages are found before PYTHON's, and its
# NVVM, with which Numba compiles, by the dynamic linker.
unpack() {
  local last=${parts[-1]} digest
  [ "${last##*of}" = ${#parts[@]} ] || fail "${last##*/} is there, but only ${#parts[@]} of ${last##*of} parts are."
  digest=$(cat "${parts[@]}" | sha256sum | cut -d' ' -f1)
  [ "$digest" = "$(find "$PACK" -name site.tar.xz.sha256 -exec cat {} + | sort -u)" ] ||
    fail "the joined parts in $PACK have another digest than site.tar.xz.sha256; transfer them again."
  if [ "$(cat "$WORK/unpacked" 2> /dev/null)" != "$digest" ]; then
    rm -rf "$WORK/unpacked" "$WORK/pack"
    cat "${parts[@]}" | "$PYTHON" -c 'import sys, tarfile
with tarfile.open(fileobj=sys.stdin.buffer, mode="r|xz") as tar:
    tar.extractall(sys.argv[1], filter="data")' "$WORK/pack" || fail "the archive in $PACK is damaged."
    [ ! -d "$WORK/pack/warp-cache" ] || cp -r "$WORK/pack/warp-cache" "$WORK/"
    echo "$digest" > "$WORK/unpacked"
  fi
  export PYTHONPATH=$WORK/pack/site${PYTHONPATH:+:$PYTHONPATH}
  export LD_LIBRARY_PATH=$WORK/pack/site/nvidia/cu13/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
}

smoke() {
  local options=(--device "$DEVICE")
  [ -z "$TINY" ] || options+=(--num-envs 4 --image-size 32)
  timeout "$LIMIT_S" "$PYTHON" -m benchmarks.gpu_smoke "${options[@]}" 2>&1 | tee "$WORK/smoke.txt" ||
    fail "first contact failed. See $OUT/smoke.txt."
}

parity() {
  local tests chosen=cuda
  # Only files with tests for a GPU: other tests need packages that are not in PACK.
  mapfile -t tests < <(grep -rlE 'mark\.cuda|tests\.devices|tests\.world\.faces' "$here/tests" --include='test_*.py' | grep -v '/bench/' | sort)
  # Without a GPU the same comparisons run on the CPU device.
  [ "$DEVICE" = cuda ] || chosen='not cuda'
  [ -z "$TINY" ] || { chosen="$chosen and not slow" tests=("$here/tests/learn/test_device.py"); }
  timeout "$LIMIT_S" "$PYTHON" -m pytest -q -p no:cacheprovider -m "$chosen" "${tests[@]}" 2>&1 |
    tee "$WORK/parity.txt" || fail "the parity tests failed; nothing is measured. See $OUT/parity.txt."
  if [ "$DEVICE" = cuda ] && ! { tail -1 "$WORK/parity.txt" | grep -q ' passed' && ! tail -1 "$WORK/parity.txt" | grep -q skipped; }; then
    fail "parity tests were skipped; a GPU must run them all. See $OUT/parity.txt."
  fi
}

bench() {
  local options=(--device "$DEVICE" --num-envs $BENCH_ROWS --seconds "$BENCH_SECONDS")
  [ -z "$TINY" ] || options+=(--num-envs 4 8 --seconds 0.05 --image-size 32 --rollout-steps 5
    --matmul-side 64 --copy-bytes 1000000)
  # shellcheck disable=SC2086
  timeout "$LIMIT_S" "$PYTHON" -m knowarm bench gpu --json "$WORK/gpu.json" --resume \
    "${options[@]}" ${BENCH_OPTIONS:-} || fail "the benchmark was interrupted; call again to measure the missing rows."
}

train() {
  local times=$WORK/times begun=$WORK/begun options
  [ -f "$WORK/gpu.json" ] || fail "train adds its result to gpu.json; run the stage bench first."
  if [ ! -f "$WORK/trained" ]; then
    if [ -d "$run/checkpoints/latest" ] || [ -d "$run/checkpoints/previous" ]; then
      # The time of a killed call ends with the last row of metrics.
      [ ! -f "$begun" ] || echo "$(cat "$begun") $(stat -c %Y "$run/metrics.csv")" >> "$times"
      options=(--resume)
    else
      rm -rf "$run" "$times"
      options=(--algorithm.device "$DEVICE")
      if [ -n "$TINY" ]; then
        options+=(--total-steps 80 --algorithm.num-envs 8 --algorithm.minibatches 2 --algorithm.rollout-steps 5
          --interim.every-steps 40 --interim.episodes 2 --checkpoint-every-steps 40)
      else
        # Checkpoints hold the environments' last images: fewer than on the CPU.
        # An interim evaluation takes two CPU cores for seconds: 140 of them, not 1,400.
        options+=(--total-steps "$TOTAL_STEPS" --algorithm.num-envs 4096 --algorithm.minibatches 16
          --checkpoint-every-steps 10000000 --interim.every-steps 500000)
      fi
      # shellcheck disable=SC2206
      options+=(${TRAIN_OPTIONS:-})
    fi
    date +%s.%N > "$begun"
    # On SIGTERM the command saves and exits with 0; --foreground signals only the command itself.
    timeout --foreground --preserve-status --kill-after=30 "$LIMIT_S" \
      "$PYTHON" -m knowarm train "$experiment" --runs "$WORK/runs" "${options[@]}" || fail "the training failed."
    echo "$(cat "$begun") $(date +%s.%N)" >> "$times"
    rm "$begun"
  fi
  "$PYTHON" "$here/benchmarks/gpu_training.py" "$run" --json "$WORK/gpu.json" --times "$times"
  "$PYTHON" -c 'import json, sys; sys.exit(not json.load(open(sys.argv[1]))["training"]["finished"])' "$WORK/gpu.json" ||
    fail "the training was stopped after $LIMIT_S s; call again with STAGES=train to resume."
  touch "$WORK/trained"
}

export PYTHONUNBUFFERED=1
# Warp keeps its compiled kernels there, from one call to the next.
export WARP_CACHE_PATH=${WARP_CACHE_PATH:-$WORK/warp-cache}
[ -z "$PACK" ] || unpack
export PYTHONPATH=$here/src${PYTHONPATH:+:$PYTHONPATH}
cd "$here"
"$PYTHON" "$here/benchmarks/gpu_versions.py" "$DEVICE" "$here"/benchmarks/gpu-{requirements,machine}.txt
for stage in $STAGES; do
  echo "== $stage"
  "$stage"
done
publish
echo "Results are in $OUT"
