/*
 * The firmware on an RP2040, over USB. It has not been run on a board (firmware/README.md says what was tested).
 *
 * Pins, by number of the GPIO:
 *
 *     I2C   SDA 4, SCL 5 (pull-ups of 2.2 to 4.7 kohm to 3.3 V on the board; those inside are too weak for 400 kHz)
 *     SPI   MISO 16, SCK 18, MOSI 19, chip selects 6, 7, 8, 9, 10, 11, 12, 13
 *     LED   25, on while the firmware is alive
 */
#include "../core/firmware.h"

#include "hardware/gpio.h"
#include "hardware/i2c.h"
#include "hardware/spi.h"
#include "hardware/watchdog.h"
#include "pico/stdio/driver.h"
#include "pico/stdio_usb.h"
#include "pico/stdlib.h"
#include "tusb.h"

enum { SDA = 4, SCL = 5, MISO = 16, SCK = 18, MOSI = 19, FIRST_SELECT_PIN = 6, SELECTS = 8, LED = 25 };

#define I2C_HZ 400000u
#define SPI_HZ 1000000u      /* until a chip select is set */
#define MAX_SPI_HZ 24000000u /* no chip of an array bears more */
/* A byte takes 23 us at 400 kHz. A chip that holds the clock for longer than this is reported as held. */
#define I2C_BYTE_US 2000u
#define WATCHDOG_MS 1000u /* longer than the longest transaction may last: MAX_I2C_US, twice for a write and a read */
#define MAX_I2C_US 400000u

static firmware self;
static struct {
    uint8_t mode;
    uint32_t clock_hz;
} selects[SELECTS];

static uint64_t now_us(void *context) {
    (void)context;
    return time_us_64();
}

/* ---- I2C --------------------------------------------------------------------------------------------------------- */

static void start_i2c(void) {
    i2c_init(i2c0, I2C_HZ);
    gpio_set_function(SDA, GPIO_FUNC_I2C);
    gpio_set_function(SCL, GPIO_FUNC_I2C);
    gpio_pull_up(SDA);
    gpio_pull_up(SCL);
}

/* Nine clocks and a STOP: a chip that waits for the rest of a byte lets go of the data line (UM10204, 3.1.16). */
static void free_i2c(void) {
    i2c_deinit(i2c0);
    gpio_init(SDA);
    gpio_init(SCL);
    gpio_pull_up(SDA);
    gpio_pull_up(SCL);
    for (int clock = 0; clock < 9 && !gpio_get(SDA); clock++) {
        gpio_set_dir(SCL, GPIO_OUT); /* the output is 0: pulled down, never driven up */
        sleep_us(5);
        gpio_set_dir(SCL, GPIO_IN);
        sleep_us(5);
    }
    gpio_set_dir(SDA, GPIO_OUT);
    sleep_us(5);
    gpio_set_dir(SDA, GPIO_IN);
    sleep_us(5);
    start_i2c();
}

static uint i2c_budget_us(size_t size) {
    size_t budget = I2C_BYTE_US + 100u * size;
    return (uint)(budget < MAX_I2C_US ? budget : MAX_I2C_US);
}

static firmware_result outcome(int count, size_t size) {
    if (count == PICO_ERROR_TIMEOUT) {
        free_i2c();
        return FIRMWARE_HELD;
    }
    return count == (int)size ? FIRMWARE_DONE : FIRMWARE_NOBODY;
}

static firmware_result transact_i2c(void *context, uint8_t address, const uint8_t *write, size_t write_size,
                                    uint8_t *read, size_t read_size) {
    uint8_t ignored;
    (void)context;
    if (write_size > 0) {
        int count = i2c_write_timeout_us(i2c0, address, write, write_size, read_size > 0, i2c_budget_us(write_size));
        firmware_result result = outcome(count, write_size);
        if (result != FIRMWARE_DONE || read_size == 0) {
            return result;
        }
    } else if (read_size == 0) {
        /* This controller sends no address alone; whether somebody answers is asked by reading a byte. */
        read = &ignored;
        read_size = 1;
    }
    return outcome(i2c_read_timeout_us(i2c0, address, read, read_size, false, i2c_budget_us(read_size)), read_size);
}

/* ---- SPI --------------------------------------------------------------------------------------------------------- */

static void start_spi(void) {
    spi_init(spi0, SPI_HZ);
    gpio_set_function(MISO, GPIO_FUNC_SPI);
    gpio_set_function(SCK, GPIO_FUNC_SPI);
    gpio_set_function(MOSI, GPIO_FUNC_SPI);
    for (uint select = 0; select < SELECTS; select++) {
        selects[select].mode = 0;
        selects[select].clock_hz = SPI_HZ;
        gpio_init(FIRST_SELECT_PIN + select);
        gpio_put(FIRST_SELECT_PIN + select, true);
        gpio_set_dir(FIRST_SELECT_PIN + select, GPIO_OUT);
    }
}

static firmware_result set_select(void *context, uint8_t select, uint8_t mode, uint32_t clock_hz) {
    (void)context;
    if (clock_hz == 0) {
        return FIRMWARE_REFUSED;
    }
    selects[select].mode = mode;
    selects[select].clock_hz = clock_hz < MAX_SPI_HZ ? clock_hz : MAX_SPI_HZ;
    return FIRMWARE_DONE;
}

static firmware_result transact_spi(void *context, uint8_t select, const uint8_t *write, size_t write_size,
                                    uint8_t *read, size_t read_size) {
    uint8_t mode = selects[select].mode;
    (void)context;
    spi_set_baudrate(spi0, selects[select].clock_hz);
    spi_set_format(spi0, 8, (mode & 2u) != 0 ? SPI_CPOL_1 : SPI_CPOL_0, (mode & 1u) != 0 ? SPI_CPHA_1 : SPI_CPHA_0,
                   SPI_MSB_FIRST);
    gpio_put(FIRST_SELECT_PIN + select, false);
    sleep_us(1);
    spi_write_blocking(spi0, write, write_size);
    spi_read_blocking(spi0, 0, read, read_size);
    sleep_us(1);
    gpio_put(FIRST_SELECT_PIN + select, true);
    return FIRMWARE_DONE;
}

/* ---- the line ---------------------------------------------------------------------------------------------------- */

static size_t send_bytes(void *context, const uint8_t *bytes, size_t size) {
    size_t room;
    (void)context;
    if (!stdio_usb_connected()) {
        return 0; /* nobody has opened the port */
    }
    room = tud_cdc_write_available();
    if (size > room) {
        size = room;
    }
    if (size > 0) {
        stdio_usb.out_chars((const char *)bytes, (int)size);
    }
    return size;
}

static void feed_watchdog(void *context) {
    (void)context;
    watchdog_update();
}

int main(void) {
    static uint8_t bytes[256];
    firmware_platform platform = {0};
    stdio_usb_init();
    gpio_init(LED);
    gpio_set_dir(LED, GPIO_OUT);
    gpio_put(LED, true);
    start_i2c();
    start_spi();
    platform.now_us = now_us;
    platform.i2c = transact_i2c;
    platform.spi = transact_spi;
    platform.spi_set = set_select;
    platform.send = send_bytes;
    platform.feed_watchdog = feed_watchdog;
    platform.selects = SELECTS;
    platform.watchdog_reset = watchdog_enable_caused_reboot();
    firmware_init(&self, &platform);
    watchdog_enable(WATCHDOG_MS, true);
    for (;;) {
        int count;
        (void)firmware_step(&self);
        count = stdio_usb.in_chars((char *)bytes, sizeof bytes);
        if (count > 0) {
            firmware_take(&self, bytes, (size_t)count);
        }
    }
}
