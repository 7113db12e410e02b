/* SPDX-License-Identifier: MIT OR Apache-2.0 */
/*
 * Driver of the DynRT chip, in C99.
 *
 * It needs <stddef.h> and <stdint.h> only: no allocation, no library, no global variables. It runs on bare metal and below an operating
 * system, on hardware and in a simulation.
 *
 * One driver is for one configuration of the chip: `dynrt generate --top chip` and `dynrt pack` write dynrt_regs.h for it. Define
 * DYNRT_REGS as "file.h" if the header has another name.
 *
 * Addresses of type uint32_t are those that the chip sees on its memory bus, in bytes. No function takes a pointer to memory that the
 * chip uses.
 *
 * A device is used by one thread at a time. dynrt_events may be called in an interrupt handler while other functions run, except
 * dynrt_wait and dynrt_run, which call it.
 */
#ifndef DYNRT_H
#define DYNRT_H

#include <stddef.h>
#include <stdint.h>

#ifndef DYNRT_REGS
#define DYNRT_REGS "dynrt_regs.h"
#endif
#include DYNRT_REGS

#ifdef __cplusplus
extern "C" {
#endif

/* What a function reports. */
enum dynrt_result {
    DYNRT_OK,
    /* The window holds no DynRT chip: ID is another one. */
    DYNRT_WRONG_ID,
    /* The chip has another major version of its interface than the header, or an older minor one. */
    DYNRT_WRONG_VERSION,
    /* The chip has another configuration than the header: FORMAT, PACKETS or TREE differ. */
    DYNRT_WRONG_MACHINE,
    /* An address is not a multiple of what the chip demands. */
    DYNRT_MISALIGNED,
    /* A count is 0 or too large, an index is too large, or numbers describe no camera or picture. */
    DYNRT_OUT_OF_RANGE,
    /* The place for a command list is too small. */
    DYNRT_NO_ROOM,
    /* dynrt_submit: one list is queued already. dynrt_run: a list runs. */
    DYNRT_BUSY,
    /* What was waited for has not happened. */
    DYNRT_TIMED_OUT,
    /* A list has ended with an error: dynrt_fault says which. */
    DYNRT_LIST_FAILED
};

/* Text of a result. A constant string, never NULL. */
const char *dynrt_result_text(enum dynrt_result result);

/*
 * How the driver reaches a chip. All unused members are NULL or 0.
 *
 * Memory-mapped hardware: set `registers`, `memory` and `memory_address`. The driver then accesses registers as words of 32 bits in the
 * byte order of the processor, and memory as little-endian words.
 *
 * Anything else, such as a simulation or a bus behind an adapter: set the callbacks. A callback has priority over the pointers.
 */
struct dynrt_device {
    /* The register window of DYNRT_WINDOW_BYTES, mapped as device memory. */
    volatile uint32_t *registers;
    /* The processor's address of the memory that the chip uses, and the chip's address of the same byte; both multiples of 4. */
    volatile void *memory;
    uint32_t memory_address;

    /* The first argument of every callback. */
    void *context;
    /* Registers, by offset in bytes. */
    uint32_t (*read_register)(void *context, uint32_t offset);
    void (*write_register)(void *context, uint32_t offset, uint32_t value);
    /* Words of memory. The address is a multiple of 4. The byte at the address is the least significant one of the word. */
    uint32_t (*read_memory)(void *context, uint32_t address);
    void (*write_memory)(void *context, uint32_t address, uint32_t word);
    /* Orders accesses: all before it are complete, or visible to the chip, before the first one after it. NULL: the compiler keeps the
     * order of the accesses, which is sufficient for a processor that keeps it as well. */
    void (*barrier)(void *context);
    /* Cache maintenance of a memory that the processor caches and the chip does not see through that cache. `clean` writes a range back
     * before the chip reads it, `discard` drops it before the processor reads what the chip has written. NULL: not needed. */
    void (*clean)(void *context, uint32_t address, uint32_t bytes);
    void (*discard)(void *context, uint32_t address, uint32_t bytes);
    /* Called between two polls: sleeps, yields, or advances a simulation. NULL: polls at once. */
    void (*pause)(void *context);
};

/* Registers and memory of a device. Addresses of words are multiples of 4; the driver does not check them. */
uint32_t dynrt_read_register(const struct dynrt_device *device, uint32_t offset);
void dynrt_write_register(const struct dynrt_device *device, uint32_t offset, uint32_t value);
uint32_t dynrt_read_word(const struct dynrt_device *device, uint32_t address);
void dynrt_write_word(const struct dynrt_device *device, uint32_t address, uint32_t word);

/* Copies bytes into memory. `address` is a multiple of 4 (else DYNRT_MISALIGNED). The bytes behind the last, up to a multiple of 4, become
 * 0. The range is cleaned from the cache. */
enum dynrt_result dynrt_copy_in(const struct dynrt_device *device, uint32_t address, const void *from,
        uint32_t bytes);

/* Copies bytes out of memory. `address` is a multiple of 4 (else DYNRT_MISALIGNED). The range is discarded from the cache first. */
enum dynrt_result dynrt_copy_out(const struct dynrt_device *device, uint32_t address, void *to,
        uint32_t bytes);

/* Makes what the chip has written to a range visible to dynrt_read_word and dynrt_read_hit. */
void dynrt_discard(const struct dynrt_device *device, uint32_t address, uint32_t bytes);

/* Bring-up: checks that the window holds a chip of the header's configuration, disables its interrupt and clears all pending events.
 * DYNRT_WRONG_ID, DYNRT_WRONG_VERSION or DYNRT_WRONG_MACHINE if it does not; then no register has been written. */
enum dynrt_result dynrt_open(const struct dynrt_device *device);

/*
 * Command lists. A list is built in memory, descriptor by descriptor. The first function that fails is remembered: all later ones do
 * nothing and return the same result. So only the result of dynrt_finish_list needs to be checked.
 *
 * A descriptor with a wrong address or number is refused with DYNRT_MISALIGNED or DYNRT_OUT_OF_RANGE, as the chip would.
 */
struct dynrt_list {
    const struct dynrt_device *device;
    /* The first descriptor, the next one, and the bytes that are left. */
    uint32_t address;
    uint32_t next;
    uint32_t left;
    enum dynrt_result result;
};

/* Begins a list in `bytes` of memory at `address`, a multiple of DYNRT_DESCRIPTOR_BYTES (else DYNRT_MISALIGNED). */
enum dynrt_result dynrt_begin_list(struct dynrt_list *list, const struct dynrt_device *device,
        uint32_t address, uint32_t bytes);

/* Ends the list with `end`, and cleans it from the cache. Returns the first failure of the list. */
enum dynrt_result dynrt_finish_list(struct dynrt_list *list);

/* Ends the place with a jump to another list instead of `end`; else as dynrt_finish_list. */
enum dynrt_result dynrt_finish_list_with_jump(struct dynrt_list *list, uint32_t to);

/* Waits for all commands and writes, and invalidates the caches of the chip. */
enum dynrt_result dynrt_add_fence(struct dynrt_list *list);

/* Writes `value` to the word at `address`; `interrupt` not 0: raises the event `signal`. */
enum dynrt_result dynrt_add_signal(struct dynrt_list *list, uint32_t address, uint32_t value, int interrupt);

/* Waits until the word at `address` is at least `value`, both unsigned. */
enum dynrt_result dynrt_add_wait(struct dynrt_list *list, uint32_t address, uint32_t value);

/* The arrays of a scene: addresses, and the link word of the root. */
struct dynrt_scene {
    uint32_t root;
    uint32_t nodes;
    uint32_t records;
    uint32_t vertices;
    uint32_t bounds;
};

enum dynrt_result dynrt_add_scene(struct dynrt_list *list, const struct dynrt_scene *scene);

/* Rays to cast. `rays` and `hits` are addresses, see docs/chip.md for the bytes. A ray takes DYNRT_RAY_BYTES, a short one
 * DYNRT_SHORT_RAY_BYTES; `origin` and `tmin` are those of short rays. Hits take dynrt_hits_bytes. */
struct dynrt_cast {
    uint32_t rays;
    uint32_t count;
    uint32_t hits;
    /* Not 0: only whether there is a hit, one bit for each ray. */
    int any_hit;
    /* Not 0: short rays. */
    int short_rays;
    float origin[3];
    float tmin;
};

enum dynrt_result dynrt_add_cast(struct dynrt_list *list, const struct dynrt_cast *cast);

/* A mesh to skin. `vertices` and `influences` are addresses, the rest are indices and numbers of records. */
struct dynrt_skin {
    uint32_t vertices;
    uint32_t palette;
    uint32_t joints;
    uint32_t influences;
    uint32_t rows;
    uint32_t rest;
    uint32_t count;
    uint32_t target;
};

enum dynrt_result dynrt_add_skin(struct dynrt_list *list, const struct dynrt_skin *skin);

/* An object to update. `first_vertex` and `first_node` are indices, `rows` a number, the rest are addresses. */
struct dynrt_update {
    uint32_t program;
    uint32_t rows;
    uint32_t vertices;
    uint32_t first_vertex;
    uint32_t nodes;
    uint32_t first_node;
    uint32_t bounds;
};

enum dynrt_result dynrt_add_update(struct dynrt_list *list, const struct dynrt_update *update);

/* Starts the list at an address, or queues it if one runs. DYNRT_MISALIGNED for a wrong address, DYNRT_BUSY if one is queued already; both
 * have no effect. */
enum dynrt_result dynrt_submit(const struct dynrt_device *device, uint32_t list);

/* Events: bits DYNRT_INTERRUPT_STATUS_..._MASK. */

/* Enables the interrupt for these events, and disables it for all others. */
void dynrt_enable_interrupt(const struct dynrt_device *device, uint32_t events);

/* Returns the events since the last call, and clears them: so the interrupt is low afterwards until the next event. For an interrupt
 * handler and for polling. */
uint32_t dynrt_events(const struct dynrt_device *device);

/* Polls until one of the events in `mask` has happened, `polls` times at most, with `pause` between two polls. All events that were seen,
 * also others, are added to *seen, unless it is NULL. DYNRT_TIMED_OUT if none of `mask` has happened: the list, if one runs, goes on. */
enum dynrt_result dynrt_wait(const struct dynrt_device *device, uint32_t mask, uint32_t polls,
        uint32_t *seen);

/* Submits a list to an idle chip and waits for its end; events from before are cleared. DYNRT_LIST_FAILED if it has ended with an error,
 * DYNRT_TIMED_OUT if it has not ended, DYNRT_BUSY if another one runs; else as dynrt_submit. */
enum dynrt_result dynrt_run(const struct dynrt_device *device, uint32_t list, uint32_t polls);

/* Whether a list runs or is queued. */
int dynrt_is_busy(const struct dynrt_device *device);

/* Why the last list has ended early. */
struct dynrt_fault {
    /* DYNRT_ERROR_...; DYNRT_ERROR_NONE: it has not, and the other members are 0. */
    uint32_t code;
    /* The address of the descriptor, and the address or the value that is wrong. */
    uint32_t descriptor;
    uint32_t value;
};

void dynrt_fault(const struct dynrt_device *device, struct dynrt_fault *fault);

/* Name and condition of an error code. Constant strings, never NULL. */
const char *dynrt_error_name(uint32_t code);
const char *dynrt_error_text(uint32_t code);

/* Counters at one instant, by DYNRT_COUNTER_.... Each has DYNRT_COUNTER_BITS and wraps. */
struct dynrt_counters {
    uint64_t value[DYNRT_COUNTER_COUNT];
};

void dynrt_read_counters(const struct dynrt_device *device, struct dynrt_counters *counters);

/* The increase of a counter, right as long as it has wrapped once at most. */
uint64_t dynrt_counted(const struct dynrt_counters *before, const struct dynrt_counters *after,
        uint32_t counter);

/* The name of a counter. A constant string, never NULL. */
const char *dynrt_counter_name(uint32_t counter);

/* Bytes of memory that a cast writes, at most: hits, or the words of the answers. At most 2^31, for as many rays as a cast may have. */
uint32_t dynrt_hits_bytes(uint32_t count, int any_hit);

/* A closest hit. Numbers are exact, unless the configuration has more than 8 exponent bits: then magnitudes above those of binary32
 * become infinite, and those below its least normal number 0. */
struct dynrt_hit {
    float t;
    float u;
    float v;
    /* DYNRT_NO_TRIANGLE for a miss. */
    uint32_t triangle;
    uint32_t instance;
};

/* Reads the hit of ray `ray` of a cast whose hits are at `hits`. */
void dynrt_read_hit(const struct dynrt_device *device, uint32_t hits, uint32_t ray, struct dynrt_hit *hit);

/* Whether ray `ray` of a cast of any-hit rays, whose answers are at `hits`, has a hit: 0 or 1. */
int dynrt_read_answer(const struct dynrt_device *device, uint32_t hits, uint32_t ray);

/*
 * A pinhole camera. The ray through the pixel (column, row) of a picture of width x height pixels has the direction
 * forward + x right + y up, with x = (2 column + 1 - width) / height and y = (height - 2 row - 1) / height. So the lengths of right and
 * up are those of the tangent of half the vertical field of view if forward has length 1. Coordinates are those of the vertices in
 * memory: `dynrt pack` multiplies those of a scene by 2^log2_scale, which its manifest.json holds.
 */
struct dynrt_camera {
    float eye[3];
    float forward[3];
    float right[3];
    float up[3];
};

/* A camera at `eye` that looks at `target`, with the top of the picture towards `up`; `tangent` > 0 is that of half the vertical field of
 * view. DYNRT_OUT_OF_RANGE if the target is the eye, `up` points along the view, or a number is not finite, or so large that
 * the square of a length is not. */
enum dynrt_result dynrt_look_at(struct dynrt_camera *camera, const float eye[3], const float target[3],
        const float up[3], float tangent);

/*
 * Rays of a picture. Rays are in the order of tiles of 8 x 8 pixels, along the Z curve in each tile, since the chip is fastest if
 * consecutive rays are close. Rays of pixels outside of the picture miss.
 */

/* Rays of a picture: 64 for each tile. 0 if the width or the height is 0 or above 65528. */
uint32_t dynrt_picture_rays(uint32_t width, uint32_t height);

/* The pixel of a ray of a picture `width` pixels wide, from 1. */
void dynrt_pixel_of_ray(uint32_t width, uint32_t ray, uint32_t *column, uint32_t *row);

/* Writes `count` rays from number `first` on, as short rays, to memory at cast->rays, and fills the other members of `cast` except `hits`
 * and `any_hit`. tmin is 0, tmax is infinite. A picture of more rays than DYNRT_MOST_RAYS takes several casts. DYNRT_MISALIGNED or
 * DYNRT_OUT_OF_RANGE for a wrong address, picture, or range of rays. */
enum dynrt_result dynrt_fill_rays(const struct dynrt_device *device, const struct dynrt_camera *camera,
        uint32_t width, uint32_t height, uint32_t first, uint32_t count, struct dynrt_cast *cast);

#ifdef __cplusplus
}
#endif

#endif
