#define PROOF_VARIANT baseline
#define PROOF_NAME "baseline"
#include "gaps.inc"
