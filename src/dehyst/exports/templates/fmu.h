/* The part of an FMU that does not depend on the version of FMI: input, output, whole periods, and the memory. */
#ifndef FMU_H
#define FMU_H

#include "dehyst_model.h"
#include "fmu_model.h"

#include <stddef.h>
#include <stdint.h>

/* Value references. */
enum { FMU_TIME, FMU_INPUT, FMU_OUTPUT, FMU_GAIN, FMU_OFFSET, FMU_LIMITED, FMU_SLEWED };

typedef enum fmu_phase { FMU_MADE, FMU_BEGINNING, FMU_RUNNING, FMU_ENDED } fmu_phase;

/* Numbers of an instance that are not in its loop. */
enum { FMU_GIVEN, FMU_SHOWN, FMU_NOW, FMU_NUMBERS };

/* The memory of an instance, without a pointer; equal states are equal to the last byte. */
typedef struct fmu_memory {
    char token[sizeof FMU_TOKEN + 7 - (sizeof FMU_TOKEN + 7) % 8];
    uint64_t check; /* checksum of the bytes below; only in a serialised state */
    uint64_t state; /* phase, and the clamps already reported */
    double number[FMU_NUMBERS];
    unsigned char loop[FMU_SNAPSHOT]; /* a multiple of 8 */
} fmu_memory;

/* Everything in a loop that changes. */
typedef struct fmu_loop {
    dehyst_loop loop;
    dehyst_real memory[FMU_MEMORY];
} fmu_loop;

typedef struct fmu {
    dehyst_model model;
    dehyst_real numbers[FMU_ROOM]; /* of the model */
    fmu_loop now;
    fmu_phase phase;
    double input, output, time;
    int reported; /* 1: clamped by limits, 2: slewed, 3: both */
    char message[240];
} fmu;

/* A function that fails returns 0, changes nothing, and writes the reason to `message`, which never has a % sign. */
int fmu_begin(fmu *f);
int fmu_matches(fmu *f, const char *token);
int fmu_demand(fmu *f, int holds, const char *why);
int fmu_enter(fmu *f, fmu_phase from, fmu_phase to, const char *function);
int fmu_set(fmu *f, uint32_t reference, double value);
int fmu_get(fmu *f, uint32_t reference, double *value);
int fmu_count(fmu *f, uint32_t reference, uint64_t *value);
/* Computes all periods of the step. Without a period, any step is one sample. */
int fmu_step(fmu *f, double from, double by);
/* Returns 1 if a limit or the slew rate clamped for the first time, and writes which to `message`. */
int fmu_clamped(fmu *f);

static inline int fmu_finite(double a) { return a - a == 0; }

void fmu_save(const fmu *f, fmu_memory *memory);
int fmu_restore(fmu *f, const fmu_memory *memory);
/* Writes a memory as bytes with a checksum, and reads it back; reading returns 0 if the bytes were changed. */
void fmu_serialize(const fmu_memory *memory, void *bytes);
int fmu_deserialize(fmu *f, const void *bytes, size_t size, fmu_memory *memory);

#endif
