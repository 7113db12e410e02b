/* Prints what the header of the registers says, for sim/check_rdl.py. */
#include "dynrt_regs.h"

#include <stdio.h>

/* The macro of a register and its row of the table agree. */
#define REGISTER(name, offset, access, reset)                                                        \
    if ((offset) != DYNRT_REG_##name || (reset) != DYNRT_##name##_RESET) {                           \
        return 1;                                                                                    \
    }                                                                                                \
    printf("register %s %u %s %u\n", #name, DYNRT_REG_##name, #access, DYNRT_##name##_RESET);

#define FIELD(register, name) \
    printf("field %s %s %u %u\n", #register, #name, DYNRT_##register##_##name##_SHIFT, DYNRT_##register##_##name##_MASK);

#define ERROR(name, code, text, condition) \
    if ((code) != DYNRT_ERROR_##name) {    \
        return 1;                          \
    }                                      \
    printf("error %s %u\n", #name, DYNRT_ERROR_##name);

int main(void) {
    DYNRT_FOR_EACH_REGISTER(REGISTER)
    DYNRT_FOR_EACH_FIELD(FIELD)
    DYNRT_FOR_EACH_ERROR(ERROR)
    return 0;
}
