/* What firmware/rp2040/main.c uses of the pico-sdk 2: names and types alone, so that any compiler can check the port. */
#ifndef DECLARATIONS_H
#define DECLARATIONS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef unsigned int uint;
#define PICO_ERROR_TIMEOUT (-1)

uint64_t time_us_64(void);
void sleep_us(uint64_t us);

enum gpio_function { GPIO_FUNC_SPI = 1, GPIO_FUNC_I2C = 3 };
enum { GPIO_IN = 0, GPIO_OUT = 1 };
void gpio_init(uint gpio);
void gpio_set_dir(uint gpio, bool out);
void gpio_put(uint gpio, bool value);
bool gpio_get(uint gpio);
void gpio_pull_up(uint gpio);
void gpio_set_function(uint gpio, enum gpio_function function);

typedef struct i2c_inst i2c_inst_t;
extern i2c_inst_t *const i2c0;
uint i2c_init(i2c_inst_t *i2c, uint baudrate);
void i2c_deinit(i2c_inst_t *i2c);
int i2c_write_timeout_us(i2c_inst_t *i2c, uint8_t addr, const uint8_t *src, size_t len, bool nostop, uint timeout_us);
int i2c_read_timeout_us(i2c_inst_t *i2c, uint8_t addr, uint8_t *dst, size_t len, bool nostop, uint timeout_us);

typedef struct spi_inst spi_inst_t;
extern spi_inst_t *const spi0;
typedef enum { SPI_CPHA_0, SPI_CPHA_1 } spi_cpha_t;
typedef enum { SPI_CPOL_0, SPI_CPOL_1 } spi_cpol_t;
typedef enum { SPI_LSB_FIRST, SPI_MSB_FIRST } spi_order_t;
uint spi_init(spi_inst_t *spi, uint baudrate);
uint spi_set_baudrate(spi_inst_t *spi, uint baudrate);
void spi_set_format(spi_inst_t *spi, uint data_bits, spi_cpol_t cpol, spi_cpha_t cpha, spi_order_t order);
int spi_write_blocking(spi_inst_t *spi, const uint8_t *src, size_t len);
int spi_read_blocking(spi_inst_t *spi, uint8_t repeated_tx_data, uint8_t *dst, size_t len);

void watchdog_update(void);
void watchdog_enable(uint32_t delay_ms, bool pause_on_debug);
bool watchdog_enable_caused_reboot(void);

typedef struct {
    void (*out_chars)(const char *buf, int len);
    int (*in_chars)(char *buf, int len);
} stdio_driver_t;
extern stdio_driver_t stdio_usb;
bool stdio_usb_init(void);
bool stdio_usb_connected(void);
uint32_t tud_cdc_write_available(void);

#endif
