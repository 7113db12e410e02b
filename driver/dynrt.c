/* SPDX-License-Identifier: MIT OR Apache-2.0 */
/* Driver of the DynRT chip: see dynrt.h. */

#include "dynrt.h"

/* A float and its bits. */
union number {
    float value;
    uint32_t bits;
};

#define PLUS_INFINITY 0x7f800000u
#define MINUS_INFINITY 0xff800000u

/* Pixels of the side of a tile, and rays of a tile. */
#define TILE 8u
#define TILE_RAYS (TILE * TILE)
#define MOST_PIXELS 65528u

static uint32_t bits_of(float value) {
    union number number;
    number.value = value;
    return number.bits;
}

static float float_of(uint32_t bits) {
    union number number;
    number.bits = bits;
    return number.value;
}

/* A word of memory as the processor's word, and the reverse. */
static uint32_t little_endian(uint32_t word) {
#if defined(__BYTE_ORDER__) && defined(__ORDER_BIG_ENDIAN__) && __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    return word >> 24 | (word >> 8 & 0xff00u) | (word << 8 & 0xff0000u) | word << 24;
#else
    return word;
#endif
}

static void barrier(const struct dynrt_device *device) {
    if (device->barrier) {
        device->barrier(device->context);
    }
}

static void clean(const struct dynrt_device *device, uint32_t address, uint32_t bytes) {
    if (device->clean) {
        device->clean(device->context, address, bytes);
    }
}

uint32_t dynrt_read_register(const struct dynrt_device *device, uint32_t offset) {
    if (device->read_register) {
        return device->read_register(device->context, offset);
    }
    return device->registers[offset / 4];
}

void dynrt_write_register(const struct dynrt_device *device, uint32_t offset, uint32_t value) {
    if (device->write_register) {
        device->write_register(device->context, offset, value);
    } else {
        device->registers[offset / 4] = value;
    }
}

/* The mapped word at an address of the chip. */
static volatile uint32_t *mapped(const struct dynrt_device *device, uint32_t address) {
    return (volatile uint32_t *)device->memory + (address - device->memory_address) / 4;
}

uint32_t dynrt_read_word(const struct dynrt_device *device, uint32_t address) {
    if (device->read_memory) {
        return device->read_memory(device->context, address);
    }
    return little_endian(*mapped(device, address));
}

void dynrt_write_word(const struct dynrt_device *device, uint32_t address, uint32_t word) {
    if (device->write_memory) {
        device->write_memory(device->context, address, word);
    } else {
        *mapped(device, address) = little_endian(word);
    }
}

void dynrt_discard(const struct dynrt_device *device, uint32_t address, uint32_t bytes) {
    barrier(device);
    if (device->discard) {
        device->discard(device->context, address, bytes);
    }
}

enum dynrt_result dynrt_copy_in(const struct dynrt_device *device, uint32_t address, const void *from,
        uint32_t bytes) {
    const unsigned char *source = from;
    uint32_t at;

    if (address % 4 != 0) {
        return DYNRT_MISALIGNED;
    }
    for (at = 0; at < bytes; at += 4) {
        uint32_t word = 0;
        uint32_t k;
        for (k = 0; k < 4 && k < bytes - at; k++) {
            word |= (uint32_t)source[at + k] << (8 * k);
        }
        dynrt_write_word(device, address + at, word);
    }
    clean(device, address, bytes);
    return DYNRT_OK;
}

enum dynrt_result dynrt_copy_out(const struct dynrt_device *device, uint32_t address, void *to,
        uint32_t bytes) {
    unsigned char *target = to;
    uint32_t at;

    if (address % 4 != 0) {
        return DYNRT_MISALIGNED;
    }
    dynrt_discard(device, address, bytes);
    for (at = 0; at < bytes; at += 4) {
        uint32_t word = dynrt_read_word(device, address + at);
        uint32_t k;
        for (k = 0; k < 4 && k < bytes - at; k++) {
            target[at + k] = (unsigned char)(word >> (8 * k));
        }
    }
    return DYNRT_OK;
}

enum dynrt_result dynrt_open(const struct dynrt_device *device) {
    uint32_t version;

    if (dynrt_read_register(device, DYNRT_REG_ID) != DYNRT_ID_RESET) {
        return DYNRT_WRONG_ID;
    }
    version = dynrt_read_register(device, DYNRT_REG_VERSION);
    if (version >> 16 != DYNRT_VERSION_RESET >> 16 || version < DYNRT_VERSION_RESET) {
        return DYNRT_WRONG_VERSION;
    }
    if (dynrt_read_register(device, DYNRT_REG_FORMAT) != DYNRT_FORMAT_RESET ||
        dynrt_read_register(device, DYNRT_REG_PACKETS) != DYNRT_PACKETS_RESET ||
        dynrt_read_register(device, DYNRT_REG_TREE) != DYNRT_TREE_RESET) {
        return DYNRT_WRONG_MACHINE;
    }
    dynrt_enable_interrupt(device, 0);
    (void)dynrt_events(device);
    return DYNRT_OK;
}

/* Command lists. */

enum dynrt_result dynrt_begin_list(struct dynrt_list *list, const struct dynrt_device *device,
        uint32_t address, uint32_t bytes) {
    list->device = device;
    list->address = address;
    list->next = address;
    list->left = bytes;
    list->result = address % DYNRT_DESCRIPTOR_BYTES == 0 ? DYNRT_OK : DYNRT_MISALIGNED;
    return list->result;
}

/* Remembers the first failure. */
static enum dynrt_result failed(struct dynrt_list *list, enum dynrt_result result) {
    if (list->result == DYNRT_OK) {
        list->result = result;
    }
    return list->result;
}

/* Refuses an address that is not a multiple. */
static void multiple(struct dynrt_list *list, uint32_t address, uint32_t of) {
    if (address % of != 0) {
        (void)failed(list, DYNRT_MISALIGNED);
    }
}

/* Refuses a number that is out of its range. */
static void in_range(struct dynrt_list *list, uint32_t number, uint32_t least, uint32_t most) {
    if (number < least || number > most) {
        (void)failed(list, DYNRT_OUT_OF_RANGE);
    }
}

static void index_in_range(struct dynrt_list *list, uint32_t index) {
    in_range(list, index, 0, DYNRT_GREATEST_INDEX);
}

static void rows_in_range(struct dynrt_list *list, uint32_t rows) {
    in_range(list, rows, 1, DYNRT_GREATEST_INDEX);
}

/* Begins a descriptor of zeros but for its first word, at *at. Returns 0 after a failure: its words must not be written then. */
static int begin(struct dynrt_list *list, uint32_t head, uint32_t *at) {
    uint32_t word;

    if (list->result == DYNRT_OK && list->left < DYNRT_DESCRIPTOR_BYTES) {
        list->result = DYNRT_NO_ROOM;
    }
    if (list->result != DYNRT_OK) {
        return 0;
    }
    *at = list->next;
    dynrt_write_word(list->device, *at, head);
    for (word = 1; word < DYNRT_DESCRIPTOR_WORDS; word++) {
        dynrt_write_word(list->device, *at + 4 * word, 0);
    }
    list->next += DYNRT_DESCRIPTOR_BYTES;
    list->left -= DYNRT_DESCRIPTOR_BYTES;
    return 1;
}

static void put(const struct dynrt_list *list, uint32_t at, uint32_t word, uint32_t value) {
    dynrt_write_word(list->device, at + 4 * word, value);
}

static enum dynrt_result finish(struct dynrt_list *list) {
    if (list->result == DYNRT_OK) {
        clean(list->device, list->address, list->next - list->address);
    }
    return list->result;
}

enum dynrt_result dynrt_finish_list(struct dynrt_list *list) {
    uint32_t at;

    (void)begin(list, DYNRT_OP_END, &at);
    return finish(list);
}

enum dynrt_result dynrt_finish_list_with_jump(struct dynrt_list *list, uint32_t to) {
    uint32_t at;

    multiple(list, to, DYNRT_DESCRIPTOR_BYTES);
    if (begin(list, DYNRT_OP_JUMP, &at)) {
        put(list, at, DYNRT_JUMP_WORD_TO, to);
    }
    return finish(list);
}

enum dynrt_result dynrt_add_fence(struct dynrt_list *list) {
    uint32_t at;

    (void)begin(list, DYNRT_OP_FENCE, &at);
    return list->result;
}

enum dynrt_result dynrt_add_signal(struct dynrt_list *list, uint32_t address, uint32_t value, int interrupt) {
    uint32_t at;

    multiple(list, address, DYNRT_WORD_ALIGNMENT);
    if (begin(list, DYNRT_OP_SIGNAL | (interrupt ? DYNRT_SIGNAL_FLAG_INTERRUPT : 0u), &at)) {
        put(list, at, DYNRT_SIGNAL_WORD_ADDRESS, address);
        put(list, at, DYNRT_SIGNAL_WORD_VALUE, value);
    }
    return list->result;
}

enum dynrt_result dynrt_add_wait(struct dynrt_list *list, uint32_t address, uint32_t value) {
    uint32_t at;

    multiple(list, address, DYNRT_WORD_ALIGNMENT);
    if (begin(list, DYNRT_OP_WAIT, &at)) {
        put(list, at, DYNRT_WAIT_WORD_ADDRESS, address);
        put(list, at, DYNRT_WAIT_WORD_VALUE, value);
    }
    return list->result;
}

enum dynrt_result dynrt_add_scene(struct dynrt_list *list, const struct dynrt_scene *scene) {
    uint32_t at;

    multiple(list, scene->nodes, DYNRT_BASE_ALIGNMENT);
    multiple(list, scene->records, DYNRT_BASE_ALIGNMENT);
    multiple(list, scene->vertices, DYNRT_BASE_ALIGNMENT);
    multiple(list, scene->bounds, DYNRT_BASE_ALIGNMENT);
    if (begin(list, DYNRT_OP_SCENE, &at)) {
        put(list, at, DYNRT_SCENE_WORD_ROOT, scene->root);
        put(list, at, DYNRT_SCENE_WORD_NODES, scene->nodes);
        put(list, at, DYNRT_SCENE_WORD_RECORDS, scene->records);
        put(list, at, DYNRT_SCENE_WORD_VERTICES, scene->vertices);
        put(list, at, DYNRT_SCENE_WORD_BOUNDS, scene->bounds);
    }
    return list->result;
}

enum dynrt_result dynrt_add_cast(struct dynrt_list *list, const struct dynrt_cast *cast) {
    uint32_t head = DYNRT_OP_CAST;
    uint32_t at;

    if (cast->any_hit) {
        head |= DYNRT_CAST_FLAG_ANY_HIT;
    }
    if (cast->short_rays) {
        head |= DYNRT_CAST_FLAG_SHORT_RAYS;
    }
    multiple(list, cast->rays, DYNRT_STREAM_ALIGNMENT);
    multiple(list, cast->hits, DYNRT_BASE_ALIGNMENT);
    in_range(list, cast->count, 1, DYNRT_MOST_RAYS);
    if (begin(list, head, &at)) {
        put(list, at, DYNRT_CAST_WORD_RAYS, cast->rays);
        put(list, at, DYNRT_CAST_WORD_COUNT, cast->count);
        put(list, at, DYNRT_CAST_WORD_HITS, cast->hits);
        if (cast->short_rays) {
            put(list, at, DYNRT_CAST_WORD_ORIGIN_X, bits_of(cast->origin[0]));
            put(list, at, DYNRT_CAST_WORD_ORIGIN_Y, bits_of(cast->origin[1]));
            put(list, at, DYNRT_CAST_WORD_ORIGIN_Z, bits_of(cast->origin[2]));
            put(list, at, DYNRT_CAST_WORD_TMIN, bits_of(cast->tmin));
        }
    }
    return list->result;
}

enum dynrt_result dynrt_add_skin(struct dynrt_list *list, const struct dynrt_skin *skin) {
    uint32_t at;

    multiple(list, skin->vertices, DYNRT_BASE_ALIGNMENT);
    multiple(list, skin->influences, DYNRT_STREAM_ALIGNMENT);
    index_in_range(list, skin->palette);
    in_range(list, skin->joints, 1, DYNRT_MOST_JOINTS);
    rows_in_range(list, skin->rows);
    index_in_range(list, skin->rest);
    rows_in_range(list, skin->count);
    index_in_range(list, skin->target);
    if (begin(list, DYNRT_OP_SKIN, &at)) {
        put(list, at, DYNRT_SKIN_WORD_VERTICES, skin->vertices);
        put(list, at, DYNRT_SKIN_WORD_PALETTE, skin->palette);
        put(list, at, DYNRT_SKIN_WORD_JOINTS, skin->joints);
        put(list, at, DYNRT_SKIN_WORD_INFLUENCES, skin->influences);
        put(list, at, DYNRT_SKIN_WORD_ROWS, skin->rows);
        put(list, at, DYNRT_SKIN_WORD_REST, skin->rest);
        put(list, at, DYNRT_SKIN_WORD_COUNT, skin->count);
        put(list, at, DYNRT_SKIN_WORD_TARGET, skin->target);
    }
    return list->result;
}

enum dynrt_result dynrt_add_update(struct dynrt_list *list, const struct dynrt_update *update) {
    uint32_t at;

    multiple(list, update->program, DYNRT_STREAM_ALIGNMENT);
    multiple(list, update->vertices, DYNRT_BASE_ALIGNMENT);
    multiple(list, update->nodes, DYNRT_BASE_ALIGNMENT);
    multiple(list, update->bounds, DYNRT_BOX_BYTES);
    rows_in_range(list, update->rows);
    index_in_range(list, update->first_vertex);
    index_in_range(list, update->first_node);
    if (begin(list, DYNRT_OP_UPDATE, &at)) {
        put(list, at, DYNRT_UPDATE_WORD_PROGRAM, update->program);
        put(list, at, DYNRT_UPDATE_WORD_ROWS, update->rows);
        put(list, at, DYNRT_UPDATE_WORD_VERTICES, update->vertices);
        put(list, at, DYNRT_UPDATE_WORD_FIRST_VERTEX, update->first_vertex);
        put(list, at, DYNRT_UPDATE_WORD_NODES, update->nodes);
        put(list, at, DYNRT_UPDATE_WORD_FIRST_NODE, update->first_node);
        put(list, at, DYNRT_UPDATE_WORD_BOUNDS, update->bounds);
    }
    return list->result;
}

/* Lists that run. */

enum dynrt_result dynrt_submit(const struct dynrt_device *device, uint32_t list) {
    if (list % DYNRT_DESCRIPTOR_BYTES != 0) {
        return DYNRT_MISALIGNED;
    }
    if (dynrt_read_register(device, DYNRT_REG_STATUS) & DYNRT_STATUS_QUEUED_MASK) {
        return DYNRT_BUSY;
    }
    dynrt_write_register(device, DYNRT_REG_LIST, list);
    barrier(device);
    dynrt_write_register(device, DYNRT_REG_DOORBELL, 1);
    return DYNRT_OK;
}

void dynrt_enable_interrupt(const struct dynrt_device *device, uint32_t events) {
    dynrt_write_register(device, DYNRT_REG_INTERRUPT_ENABLE, events);
}

uint32_t dynrt_events(const struct dynrt_device *device) {
    uint32_t events = dynrt_read_register(device, DYNRT_REG_INTERRUPT_STATUS);

    if (events != 0) {
        dynrt_write_register(device, DYNRT_REG_INTERRUPT_STATUS, events);
        barrier(device);
    }
    return events;
}

enum dynrt_result dynrt_wait(const struct dynrt_device *device, uint32_t mask, uint32_t polls,
        uint32_t *seen) {
    uint32_t poll;

    for (poll = 0; poll < polls; poll++) {
        uint32_t events = dynrt_events(device);
        if (seen) {
            *seen |= events;
        }
        if (events & mask) {
            return DYNRT_OK;
        }
        if (device->pause) {
            device->pause(device->context);
        }
    }
    return DYNRT_TIMED_OUT;
}

int dynrt_is_busy(const struct dynrt_device *device) {
    uint32_t status = dynrt_read_register(device, DYNRT_REG_STATUS);

    return (status & (DYNRT_STATUS_BUSY_MASK | DYNRT_STATUS_QUEUED_MASK)) != 0;
}

enum dynrt_result dynrt_run(const struct dynrt_device *device, uint32_t list, uint32_t polls) {
    const uint32_t ends = DYNRT_INTERRUPT_STATUS_END_MASK | DYNRT_INTERRUPT_STATUS_ERROR_MASK;
    uint32_t seen = 0;
    enum dynrt_result result;

    if (dynrt_is_busy(device)) {
        return DYNRT_BUSY;
    }
    (void)dynrt_events(device);
    result = dynrt_submit(device, list);
    if (result != DYNRT_OK) {
        return result;
    }
    result = dynrt_wait(device, ends, polls, &seen);
    if (result == DYNRT_OK && (seen & DYNRT_INTERRUPT_STATUS_ERROR_MASK)) {
        return DYNRT_LIST_FAILED;
    }
    return result;
}

void dynrt_fault(const struct dynrt_device *device, struct dynrt_fault *fault) {
    fault->code = dynrt_read_register(device, DYNRT_REG_ERROR_CODE);
    fault->descriptor = 0;
    fault->value = 0;
    if (fault->code != DYNRT_ERROR_NONE) {
        fault->descriptor = dynrt_read_register(device, DYNRT_REG_ERROR_DESCRIPTOR);
        fault->value = dynrt_read_register(device, DYNRT_REG_ERROR_ADDRESS);
    }
}

/* Texts. */

const char *dynrt_result_text(enum dynrt_result result) {
    switch (result) {
    case DYNRT_OK:
        return "success";
    case DYNRT_WRONG_ID:
        return "there is no DynRT chip at this address";
    case DYNRT_WRONG_VERSION:
        return "the chip has another version of the interface than the driver's header";
    case DYNRT_WRONG_MACHINE:
        return "the chip has another configuration than the driver's header";
    case DYNRT_MISALIGNED:
        return "an address is not a multiple of what it must be";
    case DYNRT_OUT_OF_RANGE:
        return "a number is out of its range";
    case DYNRT_NO_ROOM:
        return "the command list does not fit into its place";
    case DYNRT_BUSY:
        return "the chip is busy";
    case DYNRT_TIMED_OUT:
        return "the chip has not finished in time";
    case DYNRT_LIST_FAILED:
        return "the command list has ended with an error";
    }
    return "unknown result";
}

const char *dynrt_error_name(uint32_t code) {
    switch (code) {
#define NAME(name, code, text, condition) \
    case code: \
        return text;
        DYNRT_FOR_EACH_ERROR(NAME)
#undef NAME
    default:
        return "unknown";
    }
}

const char *dynrt_error_text(uint32_t code) {
    switch (code) {
#define CONDITION(name, code, text, condition) \
    case code: \
        return condition;
        DYNRT_FOR_EACH_ERROR(CONDITION)
#undef CONDITION
    default:
        return "the driver does not know this error code";
    }
}

const char *dynrt_counter_name(uint32_t counter) {
    switch (counter) {
#define NAME(name, number, text) \
    case number: \
        return text;
        DYNRT_FOR_EACH_COUNTER(NAME)
#undef NAME
    default:
        return "unknown";
    }
}

/* Counters. */

void dynrt_read_counters(const struct dynrt_device *device, struct dynrt_counters *counters) {
    uint32_t place;

    dynrt_write_register(device, DYNRT_REG_SNAPSHOT, 1);
    barrier(device);
    for (place = 0; place < DYNRT_COUNTER_COUNT; place++) {
        uint32_t offset = DYNRT_REG_COUNTERS + 8 * place;
        uint64_t low = dynrt_read_register(device, offset);
        uint64_t high = dynrt_read_register(device, offset + 4);
        counters->value[place] = high << 32 | low;
    }
}

uint64_t dynrt_counted(const struct dynrt_counters *before, const struct dynrt_counters *after,
        uint32_t counter) {
    const uint64_t all = ((uint64_t)1 << DYNRT_COUNTER_BITS) - 1;

    return (after->value[counter] - before->value[counter]) & all;
}

/* Hits. */

uint32_t dynrt_hits_bytes(uint32_t count, int any_hit) {
    if (any_hit) {
        return count / 32 * 4 + (count % 32 != 0 ? 4u : 0u);
    }
    return count * DYNRT_HIT_BYTES;
}

/* Bytes of a record in words. */
static uint64_t part(const uint32_t *words, uint32_t offset, uint32_t bytes) {
    uint64_t value = 0;
    uint32_t k;

    for (k = 0; k < bytes; k++) {
        uint32_t at = offset + k;
        value |= (uint64_t)(words[at / 4] >> (8 * (at % 4)) & 0xffu) << (8 * k);
    }
    return value;
}

/* A number of the machine's format as binary32. */
static float number(uint64_t bits) {
    const uint32_t greatest = (1u << DYNRT_EXPONENT_BITS) - 1;
    uint32_t sign = (uint32_t)(bits >> (DYNRT_EXPONENT_BITS + DYNRT_FRACTION_BITS) & 1) << 31;
    uint32_t exponent = (uint32_t)(bits >> DYNRT_FRACTION_BITS) & greatest;
    uint32_t fraction = (uint32_t)bits & ((1u << DYNRT_FRACTION_BITS) - 1);
    /* The exponent in binary32. */
    int32_t moved = (int32_t)exponent - (int32_t)(greatest / 2) + 127;

    fraction <<= 23 - DYNRT_FRACTION_BITS;
    if (exponent == 0) {
        return float_of(sign);
    }
    if (exponent == greatest) {
        return float_of(sign | PLUS_INFINITY | fraction);
    }
    if (moved >= 255) {
        return float_of(sign | PLUS_INFINITY);
    }
    if (moved <= 0) {
        return float_of(sign);
    }
    return float_of(sign | (uint32_t)moved << 23 | fraction);
}

void dynrt_read_hit(const struct dynrt_device *device, uint32_t hits, uint32_t ray, struct dynrt_hit *hit) {
    uint32_t words[DYNRT_HIT_BYTES / 4];
    uint32_t k;

    for (k = 0; k < DYNRT_HIT_BYTES / 4; k++) {
        words[k] = dynrt_read_word(device, hits + ray * DYNRT_HIT_BYTES + 4 * k);
    }
    hit->t = number(part(words, DYNRT_HIT_T_OFFSET, DYNRT_HIT_T_BYTES));
    hit->u = number(part(words, DYNRT_HIT_U_OFFSET, DYNRT_HIT_U_BYTES));
    hit->v = number(part(words, DYNRT_HIT_V_OFFSET, DYNRT_HIT_V_BYTES));
    hit->triangle = (uint32_t)part(words, DYNRT_HIT_TRIANGLE_OFFSET, DYNRT_HIT_TRIANGLE_BYTES);
    hit->instance = (uint32_t)part(words, DYNRT_HIT_INSTANCE_OFFSET, DYNRT_HIT_INSTANCE_BYTES);
}

int dynrt_read_answer(const struct dynrt_device *device, uint32_t hits, uint32_t ray) {
    return (int)(dynrt_read_word(device, hits + ray / 32 * 4) >> (ray % 32) & 1);
}

/* Cameras. */

static int is_finite(float x) {
    return (bits_of(x) & PLUS_INFINITY) != PLUS_INFINITY;
}

static float dot(const float a[3], const float b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(float to[3], const float a[3], const float b[3]) {
    to[0] = a[1] * b[2] - a[2] * b[1];
    to[1] = a[2] * b[0] - a[0] * b[2];
    to[2] = a[0] * b[1] - a[1] * b[0];
}

/* The square root of a positive, finite number: half the exponent, then Newton's steps, each of which doubles the right bits. */
static float root(float x) {
    float guess = float_of((bits_of(x) >> 1) + 0x1fc00000u);
    int step;

    for (step = 0; step < 4; step++) {
        guess = 0.5f * (guess + x / guess);
    }
    return guess;
}

/* Gives a vector a length; 0 if it has none, or one that is not finite. */
static int set_length(float v[3], float length) {
    float square = dot(v, v);
    float scale;
    int k;

    if (!(square > 0.0f) || !is_finite(square)) {
        return 0;
    }
    scale = length / root(square);
    for (k = 0; k < 3; k++) {
        v[k] *= scale;
    }
    return is_finite(dot(v, v));
}

enum dynrt_result dynrt_look_at(struct dynrt_camera *camera, const float eye[3], const float target[3],
        const float up[3], float tangent) {
    /* The square of the sine of the least angle between the view and `up`: below it, rounding decides where the top is. */
    const float least = 1e-9f;
    float upwards[3];
    int k;

    for (k = 0; k < 3; k++) {
        camera->eye[k] = eye[k];
        camera->forward[k] = target[k] - eye[k];
        upwards[k] = up[k];
    }
    if (!(tangent > 0.0f) || !set_length(camera->forward, 1.0f) || !set_length(upwards, 1.0f)) {
        return DYNRT_OUT_OF_RANGE;
    }
    cross(camera->right, camera->forward, upwards);
    if (!(dot(camera->right, camera->right) > least) || !set_length(camera->right, 1.0f)) {
        return DYNRT_OUT_OF_RANGE;
    }
    cross(camera->up, camera->right, camera->forward);
    if (!set_length(camera->right, tangent) || !set_length(camera->up, tangent)) {
        return DYNRT_OUT_OF_RANGE;
    }
    return DYNRT_OK;
}

static uint32_t tiles(uint32_t pixels) {
    return (pixels + TILE - 1) / TILE;
}

uint32_t dynrt_picture_rays(uint32_t width, uint32_t height) {
    if (width == 0 || height == 0 || width > MOST_PIXELS || height > MOST_PIXELS) {
        return 0;
    }
    return tiles(width) * tiles(height) * TILE_RAYS;
}

void dynrt_pixel_of_ray(uint32_t width, uint32_t ray, uint32_t *column, uint32_t *row) {
    uint32_t tile = ray / TILE_RAYS;

    *column = tile % tiles(width) * TILE + (ray & 1) + (ray >> 1 & 2) + (ray >> 2 & 4);
    *row = tile / tiles(width) * TILE + (ray >> 1 & 1) + (ray >> 2 & 2) + (ray >> 3 & 4);
}

/* Writes the short ray of a pixel. */
static void fill_ray(const struct dynrt_device *device, const struct dynrt_camera *camera,
        const uint32_t size[2], const uint32_t pixel[2], uint32_t address) {
    float x = (float)((int32_t)(2 * pixel[0] + 1) - (int32_t)size[0]) / (float)size[1];
    float y = (float)((int32_t)size[1] - (int32_t)(2 * pixel[1] + 1)) / (float)size[1];
    int is_inside = pixel[0] < size[0] && pixel[1] < size[1];
    uint32_t k;

    for (k = 0; k < 3; k++) {
        float direction = camera->forward[k] + x * camera->right[k] + y * camera->up[k];
        dynrt_write_word(device, address + 4 * k, bits_of(direction));
    }
    dynrt_write_word(device, address + 12, is_inside ? PLUS_INFINITY : MINUS_INFINITY);
}

enum dynrt_result dynrt_fill_rays(const struct dynrt_device *device, const struct dynrt_camera *camera,
        uint32_t width, uint32_t height, uint32_t first, uint32_t count, struct dynrt_cast *cast) {
    uint32_t all = dynrt_picture_rays(width, height);
    uint32_t size[2];
    uint32_t k;

    if (cast->rays % DYNRT_STREAM_ALIGNMENT != 0) {
        return DYNRT_MISALIGNED;
    }
    if (first >= all || count == 0 || count > all - first || count > DYNRT_MOST_RAYS) {
        return DYNRT_OUT_OF_RANGE;
    }
    size[0] = width;
    size[1] = height;
    for (k = 0; k < count; k++) {
        uint32_t pixel[2];
        dynrt_pixel_of_ray(width, first + k, &pixel[0], &pixel[1]);
        fill_ray(device, camera, size, pixel, cast->rays + k * DYNRT_SHORT_RAY_BYTES);
    }
    clean(device, cast->rays, count * DYNRT_SHORT_RAY_BYTES);
    cast->count = count;
    cast->short_rays = 1;
    cast->tmin = 0.0f;
    for (k = 0; k < 3; k++) {
        cast->origin[k] = camera->eye[k];
    }
    return DYNRT_OK;
}
