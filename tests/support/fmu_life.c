/* Two instances of an FMU 2.0 of a compensator from the beginning to the end; one goes back and does it again. */
#include "all.c"

#define STEPS 200

static double path(int t) { return 1e-7 * ((t * 37) % 101); }

static void logged(void *c, const char *name, fmi2Status status, const char *category, const char *message, ...)
{
    (void)c, (void)name, (void)status, (void)category, (void)message;
}

static void live(fmi2Component c, int from, int late, double *out)
{
    const unsigned int in = FMU_INPUT, result = FMU_OUTPUT;
    int t;
    for (t = from; t < STEPS; t++) {
        const double y = path(t);
        if (fmi2SetReal(c, &in, 1, &y) != fmi2OK) exit(2);
        if (fmi2DoStep(c, (t + late) * MODEL_PERIOD, MODEL_PERIOD, 1) != fmi2OK) exit(3);
        if (fmi2GetReal(c, &result, 1, out + t) != fmi2OK) exit(4);
    }
}

int main(void)
{
    fmi2CallbackFunctions functions = {logged, 0, 0, 0, 0};
    double first[STEPS], again[STEPS];
    fmi2FMUstate state = NULL, copy = NULL;
    fmi2Component c[2];
    size_t size;
    char *bytes;
    int i;
    if (fmi2Instantiate("x", fmi2CoSimulation, "no token", "", &functions, 0, 1) != NULL) return 1;
    for (i = 0; i < 2; i++) {
        c[i] = fmi2Instantiate(i ? "second" : NULL, fmi2CoSimulation, FMU_TOKEN, "", i ? &functions : NULL, 0, 1);
        fmi2SetupExperiment(c[i], 0, 0, 0, 0, 0);
        fmi2EnterInitializationMode(c[i]);
        fmi2ExitInitializationMode(c[i]);
        live(c[i], 0, 0, first);
        if (fmi2DoStep(c[i], 0, MODEL_PERIOD / 2, 1) != fmi2Error) return 5;
    }
    fmi2GetFMUstate(c[0], &state);
    live(c[0], 50, STEPS - 50, first);
    fmi2SerializedFMUstateSize(c[0], state, &size);
    bytes = malloc(size);
    fmi2SerializeFMUstate(c[0], state, bytes, size);
    fmi2DeSerializeFMUstate(c[1], bytes, size, &copy);
    fmi2FreeInstance(c[0]);
    fmi2SetFMUstate(c[1], copy);
    live(c[1], 50, STEPS - 50, again);
    puts(memcmp(first + 50, again + 50, (STEPS - 50) * sizeof(double)) == 0 ? "alike" : "different");
    fmi2GetFMUstate(c[1], &state);
    fmi2FreeFMUstate(c[1], &state);
    fmi2FreeFMUstate(c[1], &state);
    fmi2FreeFMUstate(c[1], &copy);
    free(bytes);
    fmi2Reset(c[1]);
    fmi2FreeInstance(c[1]);
    fmi2FreeInstance(NULL);
    return 0;
}
