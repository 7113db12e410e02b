/* SPDX-License-Identifier: MIT OR Apache-2.0 */
/* An example of the driver: see example.h. Like the driver it needs no library, so it runs on bare metal. */

#include "example.h"

/* Prints a number in decimal. */
static void print_number(dynrt_print *print, void *context, uint64_t number) {
    char text[21];
    char *at = text + sizeof text - 1;

    *at = 0;
    do {
        *--at = (char)('0' + number % 10);
        number /= 10;
    } while (number != 0);
    print(context, at);
}

static void print_line(dynrt_print *print, void *context, const char *name, uint64_t number) {
    print(context, name);
    print(context, " ");
    print_number(print, context, number);
    print(context, "\n");
}

/* Reports a failure. */
static enum dynrt_result failure(const struct dynrt_device *device, dynrt_print *print, void *context,
        enum dynrt_result result) {
    print(context, "error: ");
    print(context, dynrt_result_text(result));
    if (result == DYNRT_LIST_FAILED) {
        struct dynrt_fault fault;
        dynrt_fault(device, &fault);
        print(context, ": ");
        print(context, dynrt_error_text(fault.code));
        print(context, ", descriptor at ");
        print_number(print, context, fault.descriptor);
        print(context, ", value ");
        print_number(print, context, fault.value);
    }
    print(context, "\n");
    return result;
}

/* Hits of a cast. */
static uint32_t count_hits(const struct dynrt_device *device, uint32_t hits, uint32_t count, int any_hit) {
    uint32_t found = 0;
    uint32_t ray;

    dynrt_discard(device, hits, dynrt_hits_bytes(count, any_hit));
    for (ray = 0; ray < count; ray++) {
        if (any_hit) {
            found += (uint32_t)dynrt_read_answer(device, hits, ray);
        } else {
            struct dynrt_hit hit;
            dynrt_read_hit(device, hits, ray, &hit);
            found += hit.triangle != DYNRT_NO_TRIANGLE;
        }
    }
    return found;
}

/* Hits of all casts of a list without jumps. */
static uint64_t hits_of_list(const struct dynrt_device *device, uint32_t list) {
    uint64_t hits = 0;
    uint32_t at;

    for (at = list;; at += DYNRT_DESCRIPTOR_BYTES) {
        uint32_t head = dynrt_read_word(device, at);
        if ((head & 0xffu) == DYNRT_OP_END) {
            return hits;
        }
        if ((head & 0xffu) == DYNRT_OP_CAST) {
            uint32_t place = dynrt_read_word(device, at + 4 * DYNRT_CAST_WORD_HITS);
            uint32_t count = dynrt_read_word(device, at + 4 * DYNRT_CAST_WORD_COUNT);
            hits += count_hits(device, place, count, (head & DYNRT_CAST_FLAG_ANY_HIT) != 0);
        }
    }
}

enum dynrt_result dynrt_example(const struct dynrt_device *device, const struct dynrt_image *image,
        uint32_t polls, dynrt_print *print, void *context) {
    struct dynrt_counters before;
    struct dynrt_counters after;
    enum dynrt_result result = dynrt_open(device);

    if (result == DYNRT_OK) {
        result = dynrt_copy_in(device, image->address, image->bytes, image->size);
    }
    if (result != DYNRT_OK) {
        return failure(device, print, context, result);
    }
    dynrt_read_counters(device, &before);
    result = dynrt_run(device, image->list, polls);
    if (result != DYNRT_OK) {
        return failure(device, print, context, result);
    }
    dynrt_read_counters(device, &after);
    print_line(print, context, "rays", dynrt_counted(&before, &after, DYNRT_COUNTER_CAST_RAYS));
    print_line(print, context, "hits", hits_of_list(device, image->list));
    print_line(print, context, "cycles", dynrt_counted(&before, &after, DYNRT_COUNTER_LIST_CYCLES));
    return DYNRT_OK;
}
