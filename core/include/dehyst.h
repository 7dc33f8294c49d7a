/* dehyst: hysteresis of a piezoelectric actuator in a loop: wanted displacement [m] in, voltage [V] out, once a period.
 *
 *     static dehyst_model model;                           exported (piezo.c), or loaded: dehyst_model_load
 *     static dehyst_loop loop;
 *     static dehyst_real memory[SIZE];                     DEHYST_MEMORY(...), or dehyst_memory_size(&model)
 *     dehyst_loop_begin(&model, &loop, memory);            once
 *     volts = dehyst_loop_step(&model, &loop, memory, u);  every period
 *
 * No heap, no input or output, no globals. A model is const and may live in flash. A loop and its memory have no
 * pointers: they may be copied by = or memcpy, and kept. Only dehyst_loop_begin and dehyst_loop_restore can fail; every
 * call takes bounded time. A displacement that is not a number moves nothing. Equations: dehyst_model.h.
 */
#ifndef DEHYST_H
#define DEHYST_H

#include "dehyst_config.h"

#include <float.h>

#ifdef __cplusplus
extern "C" {
#endif

#define DEHYST_VERSION "0.1.0"
/* Blocks of another format are refused. */
#define DEHYST_MODEL_FORMAT 1
#define DEHYST_SNAPSHOT_FORMAT 1

typedef DEHYST_REAL dehyst_real;
/* What depends on the number type. A file that was compiled for another one does not link. */
#define DEHYST_TYPED_(name, type) name##_##type
#define DEHYST_TYPED(name, type) DEHYST_TYPED_(name, type)
#define DEHYST_SINGLE_double 0
#define DEHYST_SINGLE_float 1
#define DEHYST_SINGLE DEHYST_TYPED(DEHYST_SINGLE, DEHYST_REAL)
#define DEHYST_EPSILON_double DBL_EPSILON
#define DEHYST_EPSILON_float FLT_EPSILON
#define DEHYST_EPSILON DEHYST_TYPED(DEHYST_EPSILON, DEHYST_REAL)
#define DEHYST_LARGEST_double DBL_MAX
#define DEHYST_LARGEST_float FLT_MAX
#define DEHYST_LARGEST DEHYST_TYPED(DEHYST_LARGEST, DEHYST_REAL)
#define dehyst_loop_begin DEHYST_TYPED(dehyst_loop_begin, DEHYST_REAL)

typedef enum dehyst_status {
    DEHYST_OK = 0,
    DEHYST_ERR_SIZE = -1,        /* fewer than two knots, a negative count, or a null array */
    DEHYST_ERR_FINITE = -2,      /* not a number, infinite, or too large to compute with */
    DEHYST_ERR_ORDER = -3,       /* knots, spring voltages, breakaway elongations or limits not strictly increasing */
    DEHYST_ERR_SIGN = -4,        /* a negative stiffness, or a breakaway elongation that is not positive */
    DEHYST_ERR_STATE = -5,       /* a cart farther from y than its breakaway elongation, or a smooth element longer
                                  * than its length */
    DEHYST_ERR_CAPACITY = -6,    /* fewer reversals than DEHYST_STACK_CAPACITY(N) */
    DEHYST_ERR_UNREACHABLE = -7, /* carts that no history from rest leaves: use the carts until they are wiped out */
    DEHYST_ERR_LENGTH = -8,      /* a block that is cut off or too long, or sizes that do not fit it */
    DEHYST_ERR_KIND = -9,        /* not a block of this kind */
    DEHYST_ERR_FORMAT = -10,     /* a block of another format */
    DEHYST_ERR_CHECKSUM = -11,   /* a block of which a bit has changed */
    DEHYST_ERR_ROOM = -12,       /* less room than the block needs */
    DEHYST_ERR_MODEL = -13       /* a model, or a snapshot of one, of another shape than the loop's */
} dehyst_status;

/* Return the version of the core that was compiled, DEHYST_VERSION. */
const char *dehyst_version(void);
/* Return a status in words. */
const char *dehyst_status_text(dehyst_status status);

typedef struct dehyst_model dehyst_model;

/* How the voltage on offer came about. */
typedef enum dehyst_offer {
    DEHYST_NOTHING = 0,   /* nothing is on offer: the last voltage is held */
    DEHYST_CANDIDATE = 1, /* the voltage of the wanted displacement */
    DEHYST_LIMITED = 2,   /* cut at a limit */
    DEHYST_SLEWED = 3,    /* held back by the slew rate */
    DEHYST_REFUSED = 4    /* the wanted displacement is not a number: the last voltage is held */
} dehyst_offer;

/* All that changes in a loop, but its memory. */
typedef struct dehyst_loop {
    dehyst_real w, y, rate; /* displacement of the elements; with inertia, that of the mass y and y'/omega [m] */
    dehyst_real input;      /* with inertia, its input at the last step [m] */
    dehyst_real gain, offset; /* the displacement is offset + gain times that of the model; 1 and 0 m at the beginning */
    dehyst_real driven;     /* the displacement by which creep behind the elements is driven [m] */
    dehyst_real sent;       /* the last voltage */
    dehyst_real acting;     /* the voltage that acts, behind the amplifier */
    dehyst_real intended[2]; /* the last two voltages that were to act */
    dehyst_real wanted;      /* on offer: the wanted displacement, without creep behind the elements, gain and offset, */
    dehyst_real target;      /* the w that this needs, */
    dehyst_real candidate;   /* the voltage of that w, */
    dehyst_real voltage;     /* and the voltage within limits */
    dehyst_offer offer;
    int segment;                            /* of the spring, where the next search begins */
    int half;                               /* which of the two halves of the carts is the present one */
    unsigned long limited, slewed, refused; /* numbers of committed samples */
} dehyst_loop;

/* Numbers of the memory of a loop: carts of n elements, twice, elongations of l smooth elements, strains of k branches
 * of creep behind them, and the last t wanted displacements. */
#define DEHYST_MEMORY(n, l, k, t) ((2 * (n)) + (l) + (k) + (t))
/* Bytes of a snapshot of it. */
#define DEHYST_SNAPSHOT(n, l, k, t) (40 + (8 * (11 + (n) + (l) + (k) + (t))))

/* Begin from the start of the model, at rest at the voltage that holds it, as if its displacement had always been
 * wanted. If that voltage lies outside the limits, the nearest limit counts as sent. */
dehyst_status dehyst_loop_begin(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory);
/* Return the voltage for u, which then counts as sent. */
dehyst_real dehyst_loop_step(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, dehyst_real u);
/* Return the voltage for u; nothing moves until it is committed. */
dehyst_real dehyst_loop_offer(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, dehyst_real u);
/* End a period with the voltage v that was sent: the one on offer, or another. A voltage that is not accepted, see
 * dehyst_loop_accepts, counts as refused, and the last one, loop->sent, acts on. */
void dehyst_loop_commit(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, dehyst_real v);
/* End a period with any voltage: the actuator alone, without limits. A voltage that leads farther than can be computed
 * moves nothing and counts as refused. */
void dehyst_loop_play(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, dehyst_real v);
/* Return the displacement of the actuator after all voltages that were sent, with gain and offset. */
dehyst_real dehyst_loop_displacement(const dehyst_model *model, const dehyst_loop *loop, const dehyst_real *memory);
/* Set gain and offset of the displacement between two periods, for instance as a temperature or a sensor asks for. What is
 * on offer is withdrawn, and the next voltages follow as fast as the slew rate allows.
 * @param offset [m]
 * @return DEHYST_ERR_SIGN or DEHYST_ERR_FINITE if the gain is not positive, or a number not finite: nothing changes then */
dehyst_status dehyst_loop_scale(dehyst_loop *loop, dehyst_real gain, dehyst_real offset);
/* Why a sensor is not believed. */
typedef enum dehyst_fault {
    DEHYST_BELIEVED = 0,   /* it is believed */
    DEHYST_FAR = 1,        /* most readings are farther from the model than the bound: another unit, scale or zero */
    DEHYST_STUCK = 2,      /* it hardly moves while the actuator does */
    DEHYST_SCALED = 3,     /* it moves less than half, or more than twice, as much as the actuator */
    DEHYST_CONTRADICTS = 4 /* it moves at other times: inverted, late by more than a sixth of a cycle, or noise */
} dehyst_fault;
/* What a sensor says over a cycle, beside what it should: sums about a displacement, and about a usual miss [m]. */
typedef struct dehyst_sensor {
    dehyst_real expected, miss, way, missed; /* both, and the sums [m] */
    dehyst_real moved, common, spread;       /* sums of squares, and of the product [m^2] */
    unsigned long near_count, far_count;     /* readings within the bound, and beyond */
} dehyst_sensor;
/* Return whether a sensor is believed after a cycle of n readings beside those that are expected [m], by a bound [m]. */
dehyst_fault dehyst_sensor_judge(const dehyst_real *expected, const dehyst_real *reading, long n, dehyst_real bound);

/* Most samples by which a reading may be late. */
#ifndef DEHYST_FEEDBACK_LATE
#define DEHYST_FEEDBACK_LATE 63
#endif
/* An integral of the error of a sensor, ahead of the loop. */
typedef struct dehyst_feedback {
    dehyst_real gain, bound, least;            /* of a reading, largest correction [m], motion that can be judged [m] */
    dehyst_real correction;                    /* added to the wanted displacement [m] */
    dehyst_real rest, back; /* where it goes without a sensor, and how far in a period [m] */
    dehyst_real low, high, last, travelled, sum; /* of the present cycle, and the sum of its corrections [m] */
    dehyst_real heard;                           /* what was travelled at the last reading [m] */
    dehyst_real past[DEHYST_FEEDBACK_LATE + 1]; /* displacements that were meant [m] */
    int late, at;
    unsigned long samples; /* of the present cycle */
    dehyst_real usual;    /* mean square of the last mismatch that was no surprise [m^2]; 0: there is none */
    dehyst_real moved;    /* range of the cycle before [m] */
    unsigned long lasted; /* samples of the cycle before */
    int up;               /* whether the present cycle began upwards */
    int trial;            /* 0: none; else its cycle: three without a correction, one with it again */
    dehyst_fault fault;   /* DEHYST_BELIEVED, or why the sensor is not believed any more */
    dehyst_sensor sensor;
} dehyst_feedback;
/* Begin to feed back a sensor, without a correction; after a fault, this begins anew.
 * @param gain share of the error that a reading takes away, 0 to 1; `Feedback.gain` in Python keeps a margin
 * @param bound largest correction, and farthest that a reading may be from the model [m]
 * @param late periods by which a reading is late; with preview, the samples ahead
 * @return DEHYST_ERR_SIGN, DEHYST_ERR_FINITE or DEHYST_ERR_SIZE if a number is impossible */
dehyst_status dehyst_feedback_begin(const dehyst_model *model, const dehyst_loop *loop, const dehyst_real *memory,
                                    dehyst_real gain, dehyst_real bound, int late, dehyst_feedback *feedback);
/* Return the correction [m] to add to the wanted displacement of this period. Call it once a period, before the step or
 * the offer. A voltage that limits or slew rate changed makes no error. While the sensor says nothing, the correction is
 * held, after a cycle its mean; after a cycle in which the sensor contradicts the model it is taken back, and the sensor
 * is not believed any more. On a path that repeats, a mismatch that grows starts a trial, three cycles without a
 * correction and one with it: a mismatch that leaves after the correction, or comes back with it, is the echo of a sensor
 * that is late by whole cycles.
 * @param measured displacement [m] after all voltages sent so far; not a number: nothing was measured */
dehyst_real dehyst_feedback_correct(const dehyst_model *model, const dehyst_loop *loop, const dehyst_real *memory,
                                    dehyst_feedback *feedback, dehyst_real measured);
/* Correct and step: return the voltage, which then counts as sent. */
dehyst_real dehyst_feedback_step(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory,
                                 dehyst_feedback *feedback, dehyst_real wanted, dehyst_real measured);
/* Write a snapshot, which any processor restores bit for bit; nothing that is on offer is kept.
 * @param bytes [DEHYST_SNAPSHOT(...)] the result
 * @return their number, or 0 if `size` is less */
unsigned long dehyst_loop_save(const dehyst_model *model, const dehyst_loop *loop, const dehyst_real *memory,
                               unsigned char *bytes, unsigned long size);
/* Go on from a snapshot of a model of the same shape, for instance after a reset, or with weights of today. It is checked as
 * a whole; if it is refused, nothing changes. The next voltages follow the model as fast as its slew rate allows.
 *
 * Models have one shape if they agree in all that the memory depends on: numbers of elements, branches and taps,
 * breakaway elongations, coefficients of creep, smooth elements, amplifier and period; the frequency of a mass must be the
 * same too. Stiffnesses, grades, spring, transformer, damping and limits may differ. */
dehyst_status dehyst_loop_restore(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory,
                                  const unsigned char *bytes, unsigned long size);

#ifdef __cplusplus
}
#endif
#endif
