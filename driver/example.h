/* SPDX-License-Identifier: MIT OR Apache-2.0 */
/* An example of the driver: casts the rays of an image of memory that `dynrt pack` has written. */
#ifndef DYNRT_EXAMPLE_H
#define DYNRT_EXAMPLE_H

#include "dynrt.h"

/* Receives a text, without a line end of its own. */
typedef void dynrt_print(void *context, const char *text);

/* The image: its bytes (image.bin), and the numbers `load_address` and `command_list` of its manifest.json. */
struct dynrt_image {
    const void *bytes;
    uint32_t size;
    uint32_t address;
    uint32_t list;
};

/* Copies the image into memory, runs its list with at most `polls` polls, and prints the rays, the hits and the cycles from the start of
 * the list to its end, a line each. A failure is printed as one line. Returns the result. */
enum dynrt_result dynrt_example(const struct dynrt_device *device, const struct dynrt_image *image,
        uint32_t polls, dynrt_print *print, void *context);

#endif
