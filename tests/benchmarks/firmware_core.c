/* Frames a second of processor that the firmware's core makes of eight chips that answer at once; prints the number. */
#include "firmware.h"

#include <stdio.h>
#include <string.h>
#include <time.h>

static firmware self;
static uint64_t clock_us;
static uint64_t sent_bytes;

static uint64_t now_us(void *context) {
    (void)context;
    return clock_us;
}

static firmware_result exchange(void *context, uint8_t select, const uint8_t *write, size_t write_size, uint8_t *read,
                                size_t read_size) {
    (void)context;
    (void)write;
    (void)write_size;
    for (size_t i = 0; i < read_size; i++) {
        read[i] = (uint8_t)(select + i);
    }
    return FIRMWARE_DONE;
}

static firmware_result set_select(void *context, uint8_t select, uint8_t mode, uint32_t clock_hz) {
    (void)context;
    (void)select;
    (void)mode;
    (void)clock_hz;
    return FIRMWARE_DONE;
}

static size_t send_bytes(void *context, const uint8_t *bytes, size_t size) {
    (void)context;
    (void)bytes;
    sent_bytes += size;
    return size;
}

static void command(uint8_t kind, uint16_t sequence, const uint8_t *payload, size_t size) {
    uint8_t frame[LINK_MAX_FRAME];
    memcpy(frame + LINK_HEADER, payload, size);
    firmware_take(&self, frame, link_complete(frame, kind, sequence, 0, size));
}

int main(void) {
    enum { CHIPS = 8, FRAMES = 300000, PERIOD_US = 1000 };
    uint8_t list[5 + CHIPS * 4] = {0, 1, 0, 0, 0};
    const uint8_t period[4] = {PERIOD_US & 0xFF, PERIOD_US >> 8, 0, 0};
    firmware_platform platform;
    clock_t begun;
    memset(&platform, 0, sizeof platform);
    platform.now_us = now_us;
    platform.spi = exchange;
    platform.spi_set = set_select;
    platform.send = send_bytes;
    platform.selects = CHIPS;
    firmware_init(&self, &platform);
    for (int chip = 0; chip < CHIPS; chip++) {
        const uint8_t request[4] = {(uint8_t)(0x80 + chip), 1, 14, 0x9D};
        memcpy(list + 5 + 4 * chip, request, sizeof request);
    }
    command(3, 1, list, sizeof list);
    command(4, 2, period, sizeof period);
    sent_bytes = 0;
    begun = clock();
    for (int frame = 0; frame < FRAMES; frame++) {
        (void)firmware_step(&self);
        clock_us += PERIOD_US;
    }
    printf("%.1f %.3f\n", FRAMES / ((double)(clock() - begun) / CLOCKS_PER_SEC), (double)sent_bytes / FRAMES);
    return 0;
}
