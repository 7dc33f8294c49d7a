#!/bin/sh
# The core as firmware would build it: strict warnings, link-time optimisation, no library but the compiler's own.
set -eu
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
flags="-std=c99 -O3 -Wall -Wextra -Werror -pedantic -Wconversion -Wno-sign-conversion -flto -ffp-contract=off"
sources="src/*.c src/records/*.c"
cat >"$work/main.c" <<'C'
#include "dehyst.h"
int main(void) { return dehyst_version()[0] == 0 || dehyst_status_text(DEHYST_OK)[0] == 0; }
C
# shellcheck disable=SC2086
${CC:-gcc} $flags -Iinclude -Isrc $sources "$work/main.c" -o "$work/check"
"$work/check"
# shellcheck disable=SC2086
${CC:-gcc} -std=c99 -O2 -ffreestanding -ffp-contract=off -Iinclude -Isrc -fno-pic -nostdlib -r $sources -o "$work/core.o"
needed=$(nm -u "$work/core.o" | grep -vE ' (memcpy|memset|memmove)$' || true)
[ -z "$needed" ] || { echo "the core needs from outside: $needed"; exit 1; }
# Its tests pass, under sanitizers where the compiler has them.
sanitize="-fsanitize=address,undefined -fno-sanitize-recover=all"
echo 'int main(void) { return 0; }' >"$work/empty.c"
# shellcheck disable=SC2086
${CC:-gcc} $sanitize "$work/empty.c" -o "$work/empty" 2>/dev/null || sanitize=
for test in laws blocks golden; do
    # shellcheck disable=SC2086
    ${CC:-gcc} -std=c99 -O1 -g -ffp-contract=off $sanitize -Iinclude -Isrc $sources tests/$test.c -lm -o "$work/$test"
    "$work/$test" >/dev/null
done
# The lanes of records, for AVX2.
# shellcheck disable=SC2086
[ "$(uname -m)" != x86_64 ] || ${CC:-gcc} $flags -mavx2 -Iinclude -Isrc -c src/records/elements_avx2.c -o "$work/lanes.o"
# Models of others are never exported: strict, but free to use the mathematical library.
for rival in ../packages/rivals/core/*.c; do
    # shellcheck disable=SC2086
    ${CC:-gcc} $flags -I../packages/rivals/core -c "$rival" -o "$work/rival.o"
done
# The strict build must really be strict: a core with an unused variable has to fail.
{ cat src/slip.c; echo 'int dehyst_probe(void) { int unused; return 0; }'; } >"$work/probe.c"
# shellcheck disable=SC2086
if ${CC:-gcc} $flags -Iinclude -Isrc -c "$work/probe.c" -o "$work/probe.o" 2>/dev/null; then
    echo "the warning flags no longer take effect"
    exit 1
fi
echo "core: strict build, no outside symbols, tests pass"
