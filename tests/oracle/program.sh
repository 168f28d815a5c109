# Sourced by the scripts here. Prints the path of the program as the tests know it: SURGTPGS_BIN, or this
# workspace's program, built if need be.
program_path() {
    if [ -z "${SURGTPGS_BIN:-}" ]; then
        # All packages at once: another selection has other features, and compiles everything again.
        cargo build --quiet --workspace --bins
        SURGTPGS_BIN=$(realpath "${CARGO_TARGET_DIR:-target}")/debug/surgtpgs
    fi
    echo "$SURGTPGS_BIN"
}
