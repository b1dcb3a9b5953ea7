/* Functions of FMI 3.0 that this FMU has to have and has no use for: included by fmi3.c. */
#define REFUSED(name, ...)                                          \
  FMI3_EXPORT fmi3Status FMI3(name)(fmi3Instance instance, __VA_ARGS__) { \
    return instance ? refuse((component *)instance, #name " is not supported") : fmi3Error; \
  }
#define REFUSED_ALONE(name)                                         \
  FMI3_EXPORT fmi3Status FMI3(name)(fmi3Instance instance) {        \
    return instance ? refuse((component *)instance, #name " is not supported") : fmi3Error; \
  }
/* Types without variables: of none of them all is well. */
#define NONE(name, ...)                                             \
  FMI3_EXPORT fmi3Status FMI3(name)(                                \
      fmi3Instance instance, const fmi3ValueReference vr[], size_t n, __VA_ARGS__) { \
    if (!instance) return fmi3Error;                                \
    return n ? refuse((component *)instance, #name ": there are no such variables") : fmi3OK; \
  }

NONE(fmi3SetFloat32, const float values[], size_t n_values)
NONE(fmi3GetInt8, int8_t values[], size_t n_values)
NONE(fmi3GetUInt8, uint8_t values[], size_t n_values)
NONE(fmi3GetInt16, int16_t values[], size_t n_values)
NONE(fmi3GetUInt16, uint16_t values[], size_t n_values)
NONE(fmi3GetUInt32, uint32_t values[], size_t n_values)
NONE(fmi3GetInt64, int64_t values[], size_t n_values)
NONE(fmi3GetUInt64, uint64_t values[], size_t n_values)
NONE(fmi3GetBinary, size_t sizes[], const uint8_t *values[], size_t n_values)
NONE(fmi3GetClock, bool values[])
NONE(fmi3SetInt8, const int8_t values[], size_t n_values)
NONE(fmi3SetUInt8, const uint8_t values[], size_t n_values)
NONE(fmi3SetInt16, const int16_t values[], size_t n_values)
NONE(fmi3SetUInt16, const uint16_t values[], size_t n_values)
NONE(fmi3SetUInt32, const uint32_t values[], size_t n_values)
NONE(fmi3SetInt64, const int64_t values[], size_t n_values)
NONE(fmi3SetUInt64, const uint64_t values[], size_t n_values)
NONE(fmi3SetBoolean, const bool values[], size_t n_values)
NONE(fmi3SetString, const char *const values[], size_t n_values)
NONE(fmi3SetBinary, const size_t sizes[], const uint8_t *const values[], size_t n_values)
NONE(fmi3SetClock, const bool values[])
NONE(fmi3GetIntervalDecimal, double intervals[], int qualifiers[])
NONE(fmi3GetIntervalFraction, uint64_t counters[], uint64_t resolutions[], int qualifiers[])
NONE(fmi3GetShiftDecimal, double shifts[])
NONE(fmi3GetShiftFraction, uint64_t counters[], uint64_t resolutions[])
NONE(fmi3SetIntervalDecimal, const double intervals[])
NONE(fmi3SetIntervalFraction, const uint64_t counters[], const uint64_t resolutions[])
NONE(fmi3SetShiftDecimal, const double shifts[])
NONE(fmi3SetShiftFraction, const uint64_t counters[], const uint64_t resolutions[])
NONE(fmi3GetOutputDerivatives, const int32_t orders[], double values[], size_t n_values)

REFUSED(fmi3GetNumberOfVariableDependencies, fmi3ValueReference vr, size_t *n)
REFUSED(fmi3GetVariableDependencies, fmi3ValueReference dependent, size_t elements[],
        fmi3ValueReference independents[], size_t others[], int kinds[], size_t n)
REFUSED(fmi3GetDirectionalDerivative, const fmi3ValueReference unknowns[], size_t n_unknown,
        const fmi3ValueReference knowns[], size_t n_known, const double seed[], size_t n_seed,
        double sensitivity[], size_t n_sensitivity)
REFUSED(fmi3GetAdjointDerivative, const fmi3ValueReference unknowns[], size_t n_unknown,
        const fmi3ValueReference knowns[], size_t n_known, const double seed[], size_t n_seed,
        double sensitivity[], size_t n_sensitivity)
REFUSED(fmi3UpdateDiscreteStates, bool *a, bool *b, bool *c, bool *d, bool *e, double *time)
REFUSED(fmi3CompletedIntegratorStep, bool no_set_state, bool *event, bool *terminate)
REFUSED(fmi3SetTime, double time)
REFUSED(fmi3SetContinuousStates, const double states[], size_t n)
REFUSED(fmi3GetContinuousStateDerivatives, double derivatives[], size_t n)
REFUSED(fmi3GetEventIndicators, double indicators[], size_t n)
REFUSED(fmi3GetContinuousStates, double states[], size_t n)
REFUSED(fmi3GetNominalsOfContinuousStates, double nominals[], size_t n)
REFUSED(fmi3GetNumberOfEventIndicators, size_t *n)
REFUSED(fmi3GetNumberOfContinuousStates, size_t *n)
REFUSED(fmi3ActivateModelPartition, fmi3ValueReference clock, double time)
REFUSED_ALONE(fmi3EnterEventMode)
REFUSED_ALONE(fmi3EnterConfigurationMode)
REFUSED_ALONE(fmi3ExitConfigurationMode)
REFUSED_ALONE(fmi3EvaluateDiscreteStates)
REFUSED_ALONE(fmi3EnterContinuousTimeMode)
REFUSED_ALONE(fmi3EnterStepMode)

FMI3_EXPORT fmi3Instance FMI3(fmi3InstantiateModelExchange)(const char *name, const char *token,
                                                            const char *resources, bool visible,
                                                            bool logs, void *environment,
                                                            fmi3LogMessageCallback log) {
  if (log) log(environment, fmi3Error, "logStatusError", "this FMU is for co-simulation only");
  return NULL;
}

FMI3_EXPORT fmi3Instance FMI3(fmi3InstantiateScheduledExecution)(
    const char *name, const char *token, const char *resources, bool visible, bool logs,
    void *environment, fmi3LogMessageCallback log, void (*tick)(void *), void (*lock)(void),
    void (*unlock)(void)) {
  if (log) log(environment, fmi3Error, "logStatusError", "this FMU is for co-simulation only");
  return NULL;
}
