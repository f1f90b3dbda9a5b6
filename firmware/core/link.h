/*
 * The serial link, byte by byte: frames with a CRC-32, as imuarray/bus/serial_link.py describes them.
 *
 *     offset  bytes
 *     0       2       sync: A5 5A
 *     2       2       n, length of the payload: at most 1024
 *     4       1       kind
 *     5       2       sequence
 *     7       4       time: microseconds on this counter, the lower 32 bits
 *     11      n       payload
 *     11 + n  4       CRC-32 of bytes 2 to 10 + n
 *
 * Numbers are little-endian whatever the processor is. Nothing here allocates memory or calls the system.
 */
#ifndef IMUARRAY_LINK_H
#define IMUARRAY_LINK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define LINK_MAX_PAYLOAD 1024u
#define LINK_HEADER 11u
#define LINK_OVERHEAD 15u
#define LINK_MAX_FRAME (LINK_MAX_PAYLOAD + LINK_OVERHEAD)

/* A frame inside the buffer of a receiver; `raw` is all of it. */
typedef struct {
    uint8_t kind;
    uint16_t sequence;
    const uint8_t *payload;
    size_t size;
    const uint8_t *raw;
    size_t raw_size;
} link_frame;

/* Finds frames among the bytes that arrive. `skipped` counts bytes that belonged to no frame. */
typedef struct {
    uint8_t buffer[LINK_MAX_FRAME];
    size_t size;
    size_t taken; /* bytes of the frame that was returned last */
    uint32_t skipped;
} link_receiver;

uint16_t link_get16(const uint8_t *bytes);
uint32_t link_get32(const uint8_t *bytes);
void link_put16(uint8_t *bytes, uint16_t value);
void link_put32(uint8_t *bytes, uint32_t value);
void link_put64(uint8_t *bytes, uint64_t value);

/* CRC-32 of zlib and Ethernet (reflected polynomial EDB88320). */
uint32_t link_crc32(const uint8_t *bytes, size_t size);

/*
 * Complete the frame whose payload of `size` bytes stands at frame + LINK_HEADER: header before it, checksum behind it.
 * Returns the bytes of the whole frame; 0 if `size` is more than a frame holds.
 */
size_t link_complete(uint8_t *frame, uint8_t kind, uint16_t sequence, uint32_t time_us, size_t size);

void link_receiver_init(link_receiver *receiver);

/*
 * Take bytes until a frame is whole. Returns how many of `size` were taken; `found` tells whether `frame` is valid,
 * which it is until the next call. Call again with the rest, also with no bytes, until nothing is found.
 */
size_t link_receive(link_receiver *receiver, const uint8_t *bytes, size_t size, link_frame *frame, bool *found);

/*
 * Nothing more will come of the frame that has begun, because the sender has paused: its sync begins none. A frame that
 * stands whole behind a damaged length is returned.
 */
bool link_receive_pause(link_receiver *receiver, link_frame *frame);

#endif
