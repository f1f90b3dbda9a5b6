/*
 * The firmware of an array on a microcontroller: takes commands, reads the chips, frame after frame, and sends what it
 * read. imuarray/bus/serial_link.py describes commands and answers.
 *
 * It is plain C99 without heap and without calls of the system: the port (host/, rp2040/) gives it a clock, two buses
 * and a line by the functions of `firmware_platform`, hands it the bytes that arrive (`firmware_take`) and calls
 * `firmware_step` again and again. All memory is in `firmware`, 53 KB with the sizes below.
 */
#ifndef IMUARRAY_FIRMWARE_H
#define IMUARRAY_FIRMWARE_H

#include "link.h"

#define FIRMWARE_VERSION 1u

/* Sizes that a port may set for a smaller or a larger microcontroller. */
#ifndef FIRMWARE_LISTS
#define FIRMWARE_LISTS 128u
#endif
#ifndef FIRMWARE_REQUEST_BYTES
#define FIRMWARE_REQUEST_BYTES 4096u
#endif
#ifndef FIRMWARE_LINE_BYTES
#define FIRMWARE_LINE_BYTES 8192u /* wait for the line; DATA leaves room for one answer */
#endif
#ifndef FIRMWARE_KEPT_BYTES
#define FIRMWARE_KEPT_BYTES 32768u /* of DATA that was not acknowledged, to be sent again */
#endif

#define FIRMWARE_PAUSE_US 100000u /* a frame of the host in which nothing arrives for so long was cut off */
#define FIRMWARE_IDLE_US 1000000u

/* Results of commands and transactions. */
typedef enum {
    FIRMWARE_DONE = 0,
    FIRMWARE_NOBODY = 1,  /* no chip acknowledged */
    FIRMWARE_HELD = 2,    /* a chip held the clock for too long */
    FIRMWARE_REFUSED = 3, /* no such bus, or nothing this bus can carry */
} firmware_result;

/* What a port gives; `context` is handed to every function. */
typedef struct {
    void *context;
    /* Microseconds since the start; never runs backwards. */
    uint64_t (*now_us)(void *context);
    /* One I2C transaction: START, bytes to write, repeated START, bytes to read, STOP. It ends in bounded time. */
    firmware_result (*i2c)(void *context, uint8_t address, const uint8_t *write, size_t write_size, uint8_t *read,
                           size_t read_size);
    /* One SPI transaction: bytes out, then zeros out while the bytes to read come in. NULL without SPI. */
    firmware_result (*spi)(void *context, uint8_t select, const uint8_t *write, size_t write_size, uint8_t *read,
                           size_t read_size);
    /* Mode (0 ... 3) and clock of a chip select; the clock may be lower than asked for. NULL without SPI. */
    firmware_result (*spi_set)(void *context, uint8_t select, uint8_t mode, uint32_t clock_hz);
    /* Put bytes on the line without waiting; how many were taken. */
    size_t (*send)(void *context, const uint8_t *bytes, size_t size);
    /* The firmware is alive. NULL without watchdog. */
    void (*feed_watchdog)(void *context);
    uint8_t selects;      /* chip selects of SPI */
    bool watchdog_reset;  /* this boot follows a reset by the watchdog */
} firmware_platform;

/* What went wrong since the start; the answer to STATUS. */
typedef struct {
    uint32_t sent;        /* DATA put on the line */
    uint32_t late;        /* frames for which there was no time */
    uint32_t dropped;     /* DATA for which the line had no room; it may still be kept */
    uint32_t overwritten; /* DATA that made room in the memory before it was acknowledged */
    uint32_t failures;    /* requests of lists that failed twice */
} firmware_counts;

typedef struct {
    bool used;
    uint16_t every;
    uint16_t offset;
    uint16_t start; /* of its requests in `requests` */
    uint16_t size;
} firmware_list;

typedef struct {
    uint8_t bytes[FIRMWARE_LINE_BYTES];
    size_t start;
    size_t size;
} firmware_line;

/* DATA that was not acknowledged: for each its number, 4 bytes, and the frame; oldest first, around the end. */
typedef struct {
    uint8_t bytes[FIRMWARE_KEPT_BYTES];
    size_t start;
    size_t size;
} firmware_memory;

typedef struct {
    firmware_platform platform;
    firmware_counts counts;
    link_receiver receiver;
    uint64_t heard_us;

    uint8_t command[LINK_MAX_FRAME]; /* the last one, and its answer */
    size_t command_size;
    uint8_t answer[LINK_MAX_FRAME];
    size_t answer_size;

    firmware_list lists[FIRMWARE_LISTS];
    uint8_t requests[FIRMWARE_REQUEST_BYTES];
    size_t request_bytes;

    uint32_t period_us; /* 0: no frames */
    uint64_t begun_us;
    uint64_t number; /* of the next frame */

    uint8_t data[LINK_MAX_FRAME];
    uint32_t begun[LINK_MAX_PAYLOAD / 2]; /* when each request of a list began; the lower 32 bits */
    firmware_line line;
    firmware_memory memory;
} firmware;

void firmware_init(firmware *self, const firmware_platform *platform);

/* Take bytes of the host; commands are carried out and answered. */
void firmware_take(firmware *self, const uint8_t *bytes, size_t size);

/*
 * Read the chips if the next frame is due, and put on the line what waits for it. Returns for how many microseconds
 * there is nothing to do unless bytes arrive or the line gets room, at most FIRMWARE_IDLE_US.
 */
uint32_t firmware_step(firmware *self);

/* True while bytes wait for room on the line. */
bool firmware_waiting(const firmware *self);

#endif
