/* SPDX-License-Identifier: MIT OR Apache-2.0 */
/*
 * The example as a program for Linux, on a system where the chip's registers and a memory that Linux does not use are in the physical
 * address space:
 *
 *   example REGISTERS MEMORY LOAD_ADDRESS COMMAND_LIST IMAGE
 *
 * REGISTERS is the physical address of the register window, MEMORY that of the image, both multiples of a page. LOAD_ADDRESS and
 * COMMAND_LIST are those of the image's manifest.json: addresses on the memory bus of the chip. IMAGE is image.bin. Needs access to
 * /dev/mem.
 */
#define _POSIX_C_SOURCE 200809L
#define _FILE_OFFSET_BITS 64

#include "example.h"

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

/* Polls of a millisecond each. */
#define POLLS 60000u

static void print(void *context, const char *text) {
    (void)context;
    fputs(text, stdout);
}

static void barrier(void *context) {
    (void)context;
    __sync_synchronize();
}

static void wait_a_millisecond(void *context) {
    const struct timespec time = {0, 1000000};

    (void)context;
    (void)nanosleep(&time, NULL);
}

/* Reads a file as a whole. */
static unsigned char *read_file(const char *name, uint32_t *size) {
    FILE *file = fopen(name, "rb");
    unsigned char *bytes = NULL;
    long length = -1;

    if (file && fseek(file, 0, SEEK_END) == 0) {
        length = ftell(file);
        rewind(file);
    }
    if (length > 0 && (unsigned long)length <= UINT32_MAX) {
        bytes = malloc((size_t)length);
    }
    if (bytes && fread(bytes, 1, (size_t)length, file) != (size_t)length) {
        free(bytes);
        bytes = NULL;
    }
    if (file) {
        fclose(file);
    }
    *size = (uint32_t)length;
    return bytes;
}

/* Reads a number in any base of C. */
static int number(const char *text, unsigned long long most, unsigned long long *value) {
    char *end;

    *value = strtoull(text, &end, 0);
    return *text != 0 && *end == 0 && *value <= most;
}

int main(int count, char **words) {
    struct dynrt_device device = {0};
    struct dynrt_image image;
    unsigned long long value[4];
    unsigned char *bytes;
    void *registers;
    void *memory;
    int file;
    int k;

    for (k = 0; k < 4; k++) {
        if (count != 6 || !number(words[1 + k], k < 2 ? INT64_MAX : UINT32_MAX, &value[k])) {
            fprintf(stderr, "usage: %s REGISTERS MEMORY LOAD_ADDRESS COMMAND_LIST IMAGE\n", words[0]);
            return 2;
        }
    }
    bytes = read_file(words[5], &image.size);
    if (!bytes) {
        fprintf(stderr, "error: %s cannot be read\n", words[5]);
        return 2;
    }
    file = open("/dev/mem", O_RDWR | O_SYNC);
    if (file < 0) {
        perror("error: /dev/mem");
        return 2;
    }
    registers = mmap(NULL, DYNRT_WINDOW_BYTES, PROT_READ | PROT_WRITE, MAP_SHARED, file, (off_t)value[0]);
    memory = mmap(NULL, image.size, PROT_READ | PROT_WRITE, MAP_SHARED, file, (off_t)value[1]);
    if (registers == MAP_FAILED || memory == MAP_FAILED) {
        perror("error: mmap");
        return 2;
    }
    image.bytes = bytes;
    image.address = (uint32_t)value[2];
    image.list = (uint32_t)value[3];
    device.registers = registers;
    device.memory = memory;
    device.memory_address = image.address;
    device.barrier = barrier;
    device.pause = wait_a_millisecond;
    return dynrt_example(&device, &image, POLLS, print, NULL) == DYNRT_OK ? 0 : 1;
}
