#include "link.h"

#include <string.h>

static const uint8_t SYNC[2] = {0xA5u, 0x5Au};

uint16_t link_get16(const uint8_t *bytes) {
    return (uint16_t)(bytes[0] | (uint16_t)(bytes[1] << 8));
}

uint32_t link_get32(const uint8_t *bytes) {
    return (uint32_t)link_get16(bytes) | (uint32_t)link_get16(bytes + 2) << 16;
}

void link_put16(uint8_t *bytes, uint16_t value) {
    bytes[0] = (uint8_t)(value & 0xFFu);
    bytes[1] = (uint8_t)(value >> 8);
}

void link_put32(uint8_t *bytes, uint32_t value) {
    link_put16(bytes, (uint16_t)(value & 0xFFFFu));
    link_put16(bytes + 2, (uint16_t)(value >> 16));
}

void link_put64(uint8_t *bytes, uint64_t value) {
    link_put32(bytes, (uint32_t)(value & 0xFFFFFFFFu));
    link_put32(bytes + 4, (uint32_t)(value >> 32));
}

/* Four bits at a time: 64 bytes of table, a tenth of the time of the loop over bits. */
uint32_t link_crc32(const uint8_t *bytes, size_t size) {
    static const uint32_t TABLE[16] = {
        0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
        0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
    };
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < size; i++) {
        crc ^= bytes[i];
        crc = crc >> 4 ^ TABLE[crc & 15u];
        crc = crc >> 4 ^ TABLE[crc & 15u];
    }
    return crc ^ 0xFFFFFFFFu;
}

size_t link_complete(uint8_t *frame, uint8_t kind, uint16_t sequence, uint32_t time_us, size_t size) {
    if (size > LINK_MAX_PAYLOAD) {
        return 0;
    }
    memcpy(frame, SYNC, sizeof SYNC);
    link_put16(frame + 2, (uint16_t)size);
    frame[4] = kind;
    link_put16(frame + 5, sequence);
    link_put32(frame + 7, time_us);
    link_put32(frame + LINK_HEADER + size, link_crc32(frame + 2, LINK_HEADER - 2 + size));
    return LINK_OVERHEAD + size;
}

void link_receiver_init(link_receiver *receiver) {
    receiver->size = 0;
    receiver->taken = 0;
    receiver->skipped = 0;
}

/* Forget bytes at the front. */
static void drop(link_receiver *receiver, size_t count) {
    receiver->size -= count;
    memmove(receiver->buffer, receiver->buffer + count, receiver->size);
}

/* Drop the first byte and what follows it up to the next one with which a frame may begin. */
static void skip(link_receiver *receiver) {
    const uint8_t *next = memchr(receiver->buffer + 1, SYNC[0], receiver->size - 1);
    size_t count = next == NULL ? receiver->size : (size_t)(next - receiver->buffer);
    receiver->skipped += (uint32_t)count;
    drop(receiver, count);
}

/* The bytes of the frame at the front as far as they are known; 0 if none begins there. */
static size_t frame_size(const link_receiver *receiver) {
    const uint8_t *buffer = receiver->buffer;
    size_t length;
    if (buffer[0] != SYNC[0] || (receiver->size > 1 && buffer[1] != SYNC[1])) {
        return 0;
    }
    if (receiver->size < 4) {
        return LINK_OVERHEAD;
    }
    length = link_get16(buffer + 2);
    return length <= LINK_MAX_PAYLOAD ? LINK_OVERHEAD + length : 0;
}

/* A whole frame at the front; what can't become one is dropped. */
static bool complete(link_receiver *receiver, link_frame *frame) {
    while (receiver->size > 0) {
        const uint8_t *buffer = receiver->buffer;
        size_t size = frame_size(receiver);
        if (size > receiver->size) {
            return false;
        }
        if (size > 0 && link_crc32(buffer + 2, size - 6) == link_get32(buffer + size - 4)) {
            frame->kind = buffer[4];
            frame->sequence = link_get16(buffer + 5);
            frame->payload = buffer + LINK_HEADER;
            frame->size = size - LINK_OVERHEAD;
            frame->raw = buffer;
            frame->raw_size = size;
            receiver->taken = size;
            return true;
        }
        skip(receiver);
    }
    return false;
}

size_t link_receive(link_receiver *receiver, const uint8_t *bytes, size_t size, link_frame *frame, bool *found) {
    size_t taken = 0;
    drop(receiver, receiver->taken);
    receiver->taken = 0;
    *found = complete(receiver, frame);
    while (!*found && taken < size) {
        /* As many as the frame at the front lacks: behind it may stand bytes of the next one. */
        size_t wanted = receiver->size > 0 ? frame_size(receiver) - receiver->size : 1;
        size_t count = wanted < size - taken ? wanted : size - taken;
        memcpy(receiver->buffer + receiver->size, bytes + taken, count);
        receiver->size += count;
        taken += count;
        *found = complete(receiver, frame);
    }
    return taken;
}

bool link_receive_pause(link_receiver *receiver, link_frame *frame) {
    drop(receiver, receiver->taken);
    receiver->taken = 0;
    while (!complete(receiver, frame)) {
        if (receiver->size == 0) {
            return false;
        }
        skip(receiver);
    }
    return true;
}
