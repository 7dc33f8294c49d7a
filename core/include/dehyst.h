/* dehyst: hysteresis of a piezoelectric actuator in a loop. Each period: wanted displacement [m] in, voltage [V] out.
 *
 *     static dehyst_model model;                           exported (piezo.c), or loaded: dehyst_model_load
 *     static dehyst_loop loop;
 *     static dehyst_real memory[SIZE];                     DEHYST_MEMORY(...), or dehyst_memory_size(&model)
 *     dehyst_loop_begin(&model, &loop, memory);            once
 *     volts = dehyst_loop_step(&model, &loop, memory, u);  every period
 *
 * No heap, no input or output, no globals. A model is const and may live in flash. A loop and its memory have no
 * pointers: they may be copied by = or memcpy, and kept. Only dehyst_loop_begin and dehyst_loop_restore can fail; the
 * time of every call is bounded. A displacement that is not a number changes no state. Equations: dehyst_model.h.
 */
#ifndef DEHYST_H
#define DEHYST_H

#include "dehyst_config.h"

#include <float.h>

#ifdef __cplusplus
extern "C" {
#endif

#define DEHYST_VERSION "0.1.0"
/* Format of blocks; blocks of another format are refused. */
#define DEHYST_MODEL_FORMAT 1
#define DEHYST_SNAPSHOT_FORMAT 1

typedef DEHYST_REAL dehyst_real;
/* Names that depend on the number type, so that a file compiled for another type does not link. */
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
    DEHYST_ERR_UNREACHABLE = -7, /* carts that no history from rest reaches: compute with carts, not with reversals */
    DEHYST_ERR_LENGTH = -8,      /* a block that is too short or too long, or has wrong sizes */
    DEHYST_ERR_KIND = -9,        /* not a block of this kind */
    DEHYST_ERR_FORMAT = -10,     /* a block of another format */
    DEHYST_ERR_CHECKSUM = -11,   /* a damaged block */
    DEHYST_ERR_ROOM = -12,       /* less room than the block needs */
    DEHYST_ERR_MODEL = -13       /* a model or a snapshot with another shape than the loop */
} dehyst_status;

/* Return the version of the core that was compiled, DEHYST_VERSION. */
const char *dehyst_version(void);
/* Return a status in words. */
const char *dehyst_status_text(dehyst_status status);

typedef struct dehyst_model dehyst_model;

/* Origin of the offered voltage. */
typedef enum dehyst_offer {
    DEHYST_NOTHING = 0,   /* no voltage is offered: the last voltage is held */
    DEHYST_CANDIDATE = 1, /* the voltage of the wanted displacement */
    DEHYST_LIMITED = 2,   /* clamped by a limit */
    DEHYST_SLEWED = 3,    /* slewed by the slew rate */
    DEHYST_REFUSED = 4    /* the wanted displacement is not a number: the last voltage is held */
} dehyst_offer;

/* Everything that changes in a loop, except its memory. */
typedef struct dehyst_loop {
    dehyst_real w, y, rate; /* displacement of the elements; with inertia, displacement y and y'/omega of the mass */
    dehyst_real input;      /* with inertia, its input at the last step [m] */
    dehyst_real gain, offset; /* displacement = offset + gain times the model's displacement; 1 and 0 m at the start */
    dehyst_real driven;     /* the displacement that drives creep behind the elements [m] */
    dehyst_real sent;       /* the last voltage */
    dehyst_real acting;     /* the acting voltage, which the amplifier puts out */
    dehyst_real intended[2]; /* the last two intended acting voltages */
    dehyst_real wanted;      /* the offer: wanted displacement without creep behind the elements, gain and offset, */
    dehyst_real target;      /* the w for this displacement, */
    dehyst_real candidate;   /* the voltage for this w, */
    dehyst_real voltage;     /* and the voltage within limits */
    dehyst_offer offer;
    int segment;                            /* segment of the spring where the next search begins */
    int half;                               /* which of the two halves of the carts is the present one */
    unsigned long limited, slewed, refused; /* numbers of committed samples */
} dehyst_loop;

/* Count of numbers in the memory of a loop: carts of n elements, twice, elongations of l smooth elements, strains of k
 * branches of creep behind them, and the last t wanted displacements. */
#define DEHYST_MEMORY(n, l, k, t) ((2 * (n)) + (l) + (k) + (t))
/* Bytes of a snapshot of a loop with such a memory. */
#define DEHYST_SNAPSHOT(n, l, k, t) (40 + (8 * (11 + (n) + (l) + (k) + (t))))

/* Begin from the start of the model, at rest and at its voltage, as after a long wait at its displacement. If that
 * voltage lies outside the limits, the nearest limit counts as sent. */
dehyst_status dehyst_loop_begin(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory);
/* Return the voltage for u; it counts as sent. */
dehyst_real dehyst_loop_step(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, dehyst_real u);
/* Return the voltage for u; the memory does not change until a voltage is committed. */
dehyst_real dehyst_loop_offer(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, dehyst_real u);
/* End a period with the voltage v that was sent: the offered voltage, or another one. A voltage that is not accepted,
 * see dehyst_loop_accepts, counts as refused; the last voltage, loop->sent, then stays on the actuator. */
void dehyst_loop_commit(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, dehyst_real v);
/* End a period with any voltage: this simulates the actuator without limits. A voltage whose displacement is too large
 * to compute changes nothing and counts as refused. */
void dehyst_loop_play(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, dehyst_real v);
/* Return the displacement of the actuator after all voltages that were sent, with gain and offset. */
dehyst_real dehyst_loop_displacement(const dehyst_model *model, const dehyst_loop *loop, const dehyst_real *memory);
/* Set gain and offset of the displacement between two periods, for instance for a temperature or a sensor. An open
 * offer is withdrawn, and the next voltages follow as fast as the slew rate allows.
 * @param offset [m]
 * @return DEHYST_ERR_SIGN or DEHYST_ERR_FINITE, without a change, if the gain is not positive or a number not finite */
dehyst_status dehyst_loop_scale(dehyst_loop *loop, dehyst_real gain, dehyst_real offset);
/* Reasons why a sensor is not believed. */
typedef enum dehyst_fault {
    DEHYST_BELIEVED = 0,   /* the sensor is believed */
    DEHYST_FAR = 1,        /* most readings differ from the model by more than the bound: another unit, scale or zero */
    DEHYST_STUCK = 2,      /* it hardly moves while the actuator moves */
    DEHYST_SCALED = 3,     /* it moves less than half, or more than twice, as much as the actuator */
    DEHYST_CONTRADICTS = 4 /* it moves at other times: it is inverted, late by over a sixth of a cycle, or noise */
} dehyst_fault;
/* Readings of a sensor and expected readings over a cycle: sums relative to a displacement and to a usual error [m]. */
typedef struct dehyst_sensor {
    dehyst_real expected, miss, way, missed; /* these two, and the sums [m] */
    dehyst_real moved, common, spread;       /* sums of squares, and of the product [m^2] */
    unsigned long near_count, far_count;     /* readings within the bound, and beyond */
} dehyst_sensor;
/* Return whether a sensor is believed after a cycle, from n readings, n expected readings and a bound [m]. */
dehyst_fault dehyst_sensor_judge(const dehyst_real *expected, const dehyst_real *reading, long n, dehyst_real bound);

/* Largest delay of a reading, in samples. */
#ifndef DEHYST_FEEDBACK_LATE
#define DEHYST_FEEDBACK_LATE 63
#endif
/* An integral feedback from a sensor, in front of the loop. */
typedef struct dehyst_feedback {
    dehyst_real gain, bound, least; /* of a reading; largest correction [m]; least motion for a check [m] */
    dehyst_real correction;                    /* added to the wanted displacement [m] */
    dehyst_real rest, back; /* its target without a sensor, and its change in a period [m] */
    dehyst_real low, high, last, travelled, sum; /* range and motion of the present cycle, sum of corrections [m] */
    dehyst_real heard;                           /* value of `travelled` at the last reading [m] */
    dehyst_real past[DEHYST_FEEDBACK_LATE + 1]; /* earlier wanted displacements [m] */
    int late, at;
    unsigned long samples; /* samples of the present cycle */
    dehyst_real usual;    /* mean square of the last normal mismatch [m^2]; 0: none yet */
    dehyst_real moved;    /* range of the cycle before [m] */
    unsigned long lasted; /* samples of the cycle before */
    int up;               /* whether the present cycle began with a rise */
    int trial;            /* 0: no trial; else its cycle: three without a correction, then one with it */
    dehyst_fault fault;   /* DEHYST_BELIEVED, or the reason why the sensor is no longer believed */
    dehyst_sensor sensor;
} dehyst_feedback;
/* Start the feedback of a sensor, without a correction; after a fault, this call starts it again.
 * @param gain share of the error that a reading corrects, 0 to 1; `Feedback.gain` in Python keeps a margin
 * @param bound largest correction, and largest distance of a reading from the model [m]
 * @param late delay of a reading in periods; with preview, the samples ahead
 * @return DEHYST_ERR_SIGN, DEHYST_ERR_FINITE or DEHYST_ERR_SIZE if a number is impossible */
dehyst_status dehyst_feedback_begin(const dehyst_model *model, const dehyst_loop *loop, const dehyst_real *memory,
                                    dehyst_real gain, dehyst_real bound, int late, dehyst_feedback *feedback);
/* Return the correction [m] to add to the wanted displacement of this period. Call it once a period, before the step or
 * the offer. An error due to limits or slew rate is not corrected. Without readings, the last correction is held for a
 * cycle, and then its mean. If the sensor contradicts the model over a cycle, the correction returns to 0 and the
 * sensor is no longer believed. On a path that repeats, a growing mismatch starts a trial: three cycles without a
 * correction, then one with it. A mismatch that disappears after the correction, or returns with it, is the echo of a
 * sensor that is late by whole cycles.
 * @param measured displacement [m] after all voltages sent so far; not a number: no reading */
dehyst_real dehyst_feedback_correct(const dehyst_model *model, const dehyst_loop *loop, const dehyst_real *memory,
                                    dehyst_feedback *feedback, dehyst_real measured);
/* Correct and step: return the voltage; it counts as sent. */
dehyst_real dehyst_feedback_step(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory,
                                 dehyst_feedback *feedback, dehyst_real wanted, dehyst_real measured);
/* Write a snapshot, which any processor restores bit for bit; it does not hold an open offer.
 * @param bytes [DEHYST_SNAPSHOT(...)] the result
 * @return the number of bytes, or 0 if `size` is smaller */
unsigned long dehyst_loop_save(const dehyst_model *model, const dehyst_loop *loop, const dehyst_real *memory,
                               unsigned char *bytes, unsigned long size);
/* Continue from a snapshot of a model of the same shape, for instance after a reset or an update of the model. The
 * whole snapshot is checked; if it is refused, nothing changes. The next voltages follow within the slew rate.
 *
 * The shape of a model is all that the memory depends on: numbers of elements, branches and taps, breakaway
 * elongations, coefficients of creep, smooth elements, amplifier and period. The frequency of a mass must also be the
 * same. Stiffnesses, grades, spring, transformer, damping and limits may differ. */
dehyst_status dehyst_loop_restore(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory,
                                  const unsigned char *bytes, unsigned long size);

#ifdef __cplusplus
}
#endif
#endif
