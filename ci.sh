#!/usr/bin/env bash
# The same words at a desk and in continuous integration:
#   ./ci.sh {setup|fmt|lint|test|doc|nostd|loom|mutants|fuzz|bench|same-image|all}
set -euo pipefail
cd "$(dirname "$0")"

# Fuzzing needs nightly. Everything else runs on the stable toolchain of `rust-version`.
NIGHTLY=${NIGHTLY:-nightly}
FUZZ_SECONDS=${FUZZ_SECONDS:-10}

# What the checks need beyond the toolchain; the project itself needs none of it.
setup() {
    if ! cargo fuzz --version >/dev/null 2>&1; then
        cargo install cargo-fuzz --locked --quiet
    fi
}

fmt() {
    cargo fmt --all --check
    cargo fmt --manifest-path tests/freestanding/Cargo.toml --check
    cargo fmt --manifest-path fuzz/Cargo.toml --check
    cargo fmt --manifest-path bench/left-out/Cargo.toml --check
}

lint() {
    cargo clippy --workspace --all-targets --locked -- -D warnings
    cargo clippy --manifest-path fuzz/Cargo.toml --locked -- -D warnings
    local features
    for features in triangles spheres volumes spheres,volumes triangles,shadows,lanes-avx512 spheres,shadows,lanes-avx2,lanes-avx512; do
        cargo clippy -p rt-core --lib --no-default-features --features "$features" --locked -- -D warnings
        cargo clippy -p memsavvy --no-default-features --features "$features" --locked -- -D warnings
    done
}

# The test command of the README.
tests() {
    cargo test --workspace --locked
}

doc() {
    RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --locked
}

# NO_ALLOC: both cores in a program without allocator, C library or unwinder. It runs, and has no symbol of any.
nostd() {
    cargo build --release --locked --manifest-path tests/freestanding/Cargo.toml
    local program=tests/freestanding/target/release/freestanding
    "$program"
    local found
    found=$(nm "$program" | grep -iE '__rust_alloc|__rdl_|__rg_|malloc|calloc|realloc|_Unwind|eh_personality|__libc|pthread' || true)
    if [ -n "$found" ]; then
        printf 'NO_ALLOC: symbols of an allocator, a C library or an unwinder:\n%s\n' "$found" >&2
        exit 1
    fi
    echo "NO_ALLOC: both cores run in $(stat -c %s "$program") bytes without allocator, C library or unwinder"
}

loom() {
    RUSTFLAGS="--cfg loom" cargo test -p transport-shm --test loom --release --locked --target-dir target/loom
    RUSTFLAGS="--cfg loom" cargo test -p fault-linux --lib --release --locked --target-dir target/loom
}

# Puts faults into the protocols, one at a time, and prints which engine notices which. Two minutes.
mutants() {
    RUSTFLAGS="--cfg mutants" cargo test -p dsm-core --test mutants -p dsm-sim --test scenarios -p balance-ops --test mutants --release --locked --target-dir target/mutants -- --nocapture
}

fuzz() {
    setup
    local target
    for target in $(cargo "+$NIGHTLY" fuzz list); do
        cargo "+$NIGHTLY" fuzz run "$target" -- -max_total_time="$FUZZ_SECONDS" -rss_limit_mb=2048 -timeout=10 -verbosity=0
    done
}

# Every experiment with little work: that they run and say what they should. Not what they measure.
bench() {
    cargo test -p bench --locked
}

# SAME_IMAGE in every combination; takes a quarter of an hour.
same_image() {
    MEMSAVVY_ALL=1 cargo test --release -p tests --test same_image --locked -- --nocapture
}

all() {
    fmt
    lint
    doc
    nostd
    loom
    mutants
    tests
    fuzz
}

case "${1:-all}" in
    test) tests ;;
    same-image) same_image ;;
    setup | fmt | lint | doc | nostd | loom | mutants | fuzz | bench | all) "$1" ;;
    *) sed -n '2,3p' "$0" >&2; exit 2 ;;
esac
