#!/bin/sh
# Runs every fuzz target for a short time: fuzz/run.sh [seconds-for-each] [target...]
#
# Needs a stable Rust and a C++ compiler, nothing else: the coverage
# instrumentation that libFuzzer lives on is asked for by stable flags. There
# is no AddressSanitizer in it; for that use a nightly and `cargo fuzz run`.
#
# The committed corpus is read and never written. An input that fails is saved
# to fuzz/artifacts/<target>/ and makes the script fail after all targets ran.
set -eu

cd "$(dirname "$0")"
seconds=${1:-20}
[ $# -eq 0 ] || shift
case $seconds in
'' | *[!0-9]* | 0)
    echo "usage: fuzz/run.sh [seconds-for-each] [target...]" >&2
    exit 2
    ;;
esac
targets=${*:-$(cd fuzz_targets && ls ./*.rs | sed 's|^\./||; s|\.rs$||')}

host=$(rustc -vV | sed -n 's/^host: //p')
target_dir=${CARGO_TARGET_DIR:-$PWD/target}/fuzz
# With --target these flags reach the code under test but no build script.
RUSTFLAGS="--cfg fuzzing -Cpasses=sancov-module \
-Cllvm-args=-sanitizer-coverage-level=4 \
-Cllvm-args=-sanitizer-coverage-inline-8bit-counters \
-Cllvm-args=-sanitizer-coverage-pc-table \
-Cllvm-args=-sanitizer-coverage-trace-compares \
${RUSTFLAGS:-}" \
    cargo build --release --bins --target "$host" --target-dir "$target_dir"

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
trap 'exit 130' INT TERM
failed=
for target in $targets; do
    binary=$target_dir/$host/release/$target
    if [ ! -x "$binary" ] || [ ! -d "corpus/$target" ]; then
        echo "fuzz target $target: no entry in Cargo.toml, or no directory corpus/$target" >&2
        failed="$failed $target"
        continue
    fi
    mkdir -p "$scratch/$target" "artifacts/$target"
    echo "== $target, $seconds s"
    # New inputs go to the first directory only.
    if ! "$binary" -max_total_time="$seconds" -timeout=10 -rss_limit_mb=2048 \
        -print_final_stats=1 -artifact_prefix="artifacts/$target/" \
        "$scratch/$target" "corpus/$target" >"$scratch/$target.log" 2>&1; then
        failed="$failed $target"
        grep -A 2 'panicked at' "$scratch/$target.log" >&2 || true
        tail -n 30 "$scratch/$target.log" >&2
    else
        grep -E 'DONE|number_of_executed_units|peak_rss_mb' "$scratch/$target.log"
    fi
done
if [ -n "$failed" ]; then
    echo "failed:$failed" >&2
    exit 1
fi
