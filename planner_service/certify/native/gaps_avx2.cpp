#define PROOF_VARIANT avx2
#define PROOF_NAME "avx2"
#include "gaps.inc"
