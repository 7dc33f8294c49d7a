/* Two instances of an FMU 3.0 of a compensator from the beginning to the end; one goes back and does it again. */
#include "all.c"

#define STEPS 200

static double path(int t) { return 1e-7 * ((t * 37) % 101); }

static void logged(void *c, fmi3Status status, const char *category, const char *message)
{
    (void)c, (void)status, (void)category, (void)message;
}

static void live(fmi3Instance c, int from, int late, double *out)
{
    const unsigned int in = FMU_INPUT, result = FMU_OUTPUT;
    fmi3Boolean flag[3];
    double reached;
    int t;
    for (t = from; t < STEPS; t++) {
        const double y = path(t);
        if (fmi3SetFloat64(c, &in, 1, &y, 1) != fmi3OK) exit(2);
        if (fmi3DoStep(c, (t + late) * MODEL_PERIOD, MODEL_PERIOD, 1, flag, flag + 1, flag + 2, &reached) != fmi3OK) exit(3);
        if (fmi3GetFloat64(c, &result, 1, out + t, 1) != fmi3OK) exit(4);
    }
}

int main(void)
{
    fmi3Boolean flag[3];
    double first[STEPS], again[STEPS];
    fmi3FMUState state = NULL, copy = NULL;
    fmi3Instance c[2];
    size_t size;
    fmi3Byte *bytes;
    int i;
    if (fmi3InstantiateCoSimulation("x", "no token", "", 0, 1, 0, 0, NULL, 0, NULL, logged, NULL) != NULL) return 1;
    for (i = 0; i < 2; i++) {
        c[i] = fmi3InstantiateCoSimulation(NULL, FMU_TOKEN, "", 0, 1, 0, 0, NULL, 0, NULL, i ? logged : NULL, NULL);
        fmi3EnterInitializationMode(c[i], 0, 0, 0, 0, 0);
        fmi3ExitInitializationMode(c[i]);
        live(c[i], 0, 0, first);
        if (fmi3DoStep(c[i], 0, MODEL_PERIOD / 2, 1, flag, flag + 1, flag + 2, again) != fmi3Error) return 5;
    }
    fmi3GetFMUState(c[0], &state);
    live(c[0], 50, STEPS - 50, first);
    fmi3SerializedFMUStateSize(c[0], state, &size);
    bytes = malloc(size);
    fmi3SerializeFMUState(c[0], state, bytes, size);
    fmi3DeserializeFMUState(c[1], bytes, size, &copy);
    fmi3FreeInstance(c[0]);
    fmi3SetFMUState(c[1], copy);
    live(c[1], 50, STEPS - 50, again);
    puts(memcmp(first + 50, again + 50, (STEPS - 50) * sizeof(double)) == 0 ? "alike" : "different");
    fmi3GetFMUState(c[1], &state);
    fmi3FreeFMUState(c[1], &state);
    fmi3FreeFMUState(c[1], &state);
    fmi3FreeFMUState(c[1], &copy);
    free(bytes);
    fmi3Reset(c[1]);
    fmi3FreeInstance(c[1]);
    fmi3FreeInstance(NULL);
    return 0;
}
