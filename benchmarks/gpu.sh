#!/usr/bin/env bash
# Parity tests, benchmark and a whole training on this machine's GPU. Needs no network.
#
#   benchmarks/gpu.sh [WHEELS] [OUT]
#
# WHEELS  folder of wheels, made as gpu-requirements.txt says; split files (*.whl.part*) are joined.
#         They are installed into an environment that also sees the packages of PYTHON (torch,
#         Numba). If left out or empty, only PYTHON's packages are used.
# OUT     folder for the results (the environment variable OUT, else runs/gpu): gpu.json, parity.txt, and of the training metrics.csv,
#         evaluations.csv, config.json and provenance.json.
#
# Settings, as environment variables:
#   STAGES   stages to run, of "parity bench train" (all). Each resumes an earlier call:
#            bench measures the rows that gpu.json lacks, train resumes from the last checkpoint.
#   DRY_RUN  1 to check and print sizes and commands only; nothing is installed or measured.
#   LIMIT_S  time limit per stage (480 s); train then saves and stops, call again to resume.
#   PYTHON   interpreter (python3).      WORK  folder for files kept between calls
#   DEVICE   cuda (default) or cpu.            (runs/gpu-work); remove it to start over.
#   TINY     1 for small sizes that only check that every stage runs.
#   BENCH_OPTIONS, TRAIN_OPTIONS   additional options of `knowarm bench gpu` and `knowarm train`.
set -euo pipefail

here=$(cd "$(dirname "$0")/.." && pwd)
WHEELS=${1:-} OUT=${2:-${OUT:-$here/runs/gpu}} WORK=${WORK:-$here/runs/gpu-work}
PYTHON=${PYTHON:-python3} DEVICE=${DEVICE:-cuda} TINY=${TINY:-} LIMIT_S=${LIMIT_S:-480} DRY_RUN=${DRY_RUN:-}
STAGES=${STAGES-parity bench train}
requirements=$here/benchmarks/gpu-requirements.txt
experiment=irb120-full-ppo
run=$WORK/runs/$experiment/0

fail() { echo "gpu.sh: $*" >&2; exit 1; }

for stage in $STAGES; do
  case $stage in parity | bench | train) ;; *) fail "unknown stage '$stage'; the stages are parity, bench, train." ;; esac
done
case $DEVICE in cpu | cuda) ;; *) fail "DEVICE must be cuda or cpu, got '$DEVICE'." ;; esac
[ -z "$WHEELS" ] || [ -d "$WHEELS" ] || fail "the folder of wheels $WHEELS does not exist."

# Largest file of WHEELS.
PART_BYTES=48000000

# Print what a call would do: the files that travel, and each stage with its limit.
dry_run() {
  local file size total=0
  for file in ${WHEELS:+"$WHEELS"/*.whl*}; do
    [ -f "$file" ] || continue
    size=$(stat -c %s "$file") total=$((total + $(stat -c %s "$file")))
    printf '%6d kB  %s\n' $((size / 1000)) "${file##*/}"
    [ "$size" -le $PART_BYTES ] || fail "${file##*/} has more than $((PART_BYTES / 1000000)) MB: split it (gpu-requirements.txt says how)."
  done
  echo "files in all: $((total / 1000)) kB, in $(((total + PART_BYTES - 1) / PART_BYTES)) transfers of at most $((PART_BYTES / 1000000)) MB"
  for stage in $STAGES; do
    echo "at most $LIMIT_S s: STAGES=$stage DEVICE=$DEVICE benchmarks/gpu.sh ${1:-}"
  done
}
if [ -n "$DRY_RUN" ]; then
  dry_run "${1:-}"
  exit
fi

mkdir -p "$OUT" "$WORK"
OUT=$(cd "$OUT" && pwd) WORK=$(cd "$WORK" && pwd) run=$WORK/runs/$experiment/0
[ -z "$WHEELS" ] || WHEELS=$(cd "$WHEELS" && pwd)

# Copy the results also if a later stage fails.
publish() {
  for file in "$WORK"/gpu.json "$WORK"/parity.txt "$run"/{metrics,evaluations}.csv "$run"/{config,provenance}.json; do
    [ ! -f "$file" ] || cp "$file" "$OUT/"
  done
}
trap publish EXIT

# Make an environment that sees PYTHON's packages, also if PYTHON is itself in an environment:
# --system-site-packages would only show the packages of the base Python.
install() {
  local venv=$WORK/venv
  if [ ! -x "$venv/bin/python" ]; then
    "$PYTHON" -m venv --without-pip "$venv"
    "$PYTHON" -c 'import sys
for path in sys.path:
    if path.endswith(("site-packages", "dist-packages")):
        print(f"import site; site.addsitedir({path!r})")' \
      > "$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/base.pth"
  fi
  PYTHON=$venv/bin/python
  rm -rf "$WORK/wheels"
  mkdir "$WORK/wheels"
  for wheel in "$WHEELS"/*.whl; do [ ! -e "$wheel" ] || ln -s "$wheel" "$WORK/wheels/"; done
  for part in "$WHEELS"/*.whl.part*; do
    [ ! -e "$part" ] || cat "$part" >> "$WORK/wheels/$(basename "${part%.part*}")"
  done
  compgen -G "$WORK/wheels/*.whl" > /dev/null || fail "there are no wheels in $WHEELS."
  "$PYTHON" -m pip install --quiet --disable-pip-version-check --no-index --no-deps --no-compile "$WORK"/wheels/*.whl
}

parity() {
  local tests chosen=cuda
  # Only files with tests for a GPU: other tests need packages that are not in WHEELS.
  mapfile -t tests < <(grep -rlE 'mark\.cuda|tests\.devices|tests\.world\.faces' "$here/tests" --include='test_*.py' | grep -v '/bench/' | sort)
  # Without a GPU the same comparisons run on the CPU device.
  [ "$DEVICE" = cuda ] || chosen='not cuda'
  [ -z "$TINY" ] || chosen="$chosen and not slow"
  timeout "$LIMIT_S" "$PYTHON" -m pytest -q -p no:cacheprovider -m "$chosen" "${tests[@]}" 2>&1 |
    tee "$WORK/parity.txt" || fail "the parity tests failed; nothing is measured. See $OUT/parity.txt."
  if [ "$DEVICE" = cuda ] && ! { tail -1 "$WORK/parity.txt" | grep -q ' passed' && ! tail -1 "$WORK/parity.txt" | grep -q skipped; }; then
    fail "parity tests were skipped; a GPU must run them all. See $OUT/parity.txt."
  fi
}

bench() {
  local options=(--device "$DEVICE")
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
        options+=(--total-steps 70000000 --algorithm.num-envs 4096 --algorithm.minibatches 16
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
# Numba compiles with NVVM, which it looks for below CUDA_HOME.
if [ -z "${CUDA_HOME:-}" ]; then
  for folder in "$(dirname "$(dirname "$(command -v nvcc || echo /none/bin/nvcc)")")" /usr/local/cuda /usr/local/cuda-*; do
    if [ -d "$folder/nvvm" ]; then
      export CUDA_HOME=$folder
      break
    fi
  done
fi
[ -z "$WHEELS" ] || install
export PYTHONPATH=$here/src${PYTHONPATH:+:$PYTHONPATH}
cd "$here"
"$PYTHON" "$here/benchmarks/gpu_versions.py" "$requirements" "$DEVICE"
for stage in $STAGES; do
  echo "== $stage"
  "$stage"
done
publish
echo "Results are in $OUT"
