/*
 * The firmware as a program of this machine, behind a pseudo-terminal that other programs open as they would
 * /dev/ttyACM0. Its buses are a socket: file descriptor --bus, served by firmware_emulator/bus_socket.py.
 *
 * On the socket, little-endian, one question and one answer at a time:
 *
 *     question  'I' address u8, bytes to write u16, bytes to read u16, what to write    I2C transaction
 *               'S' select u8, bytes to write u16, bytes to read u16, what to write     SPI transaction
 *               'C' select u8, mode u16, 0 u16, clock u32                               mode, clock of a chip select
 *     answer    result u8 (0 done, 1 nobody, 2 held, 3 refused), and after 0 the bytes read
 */
#define _XOPEN_SOURCE 700

#include "../core/firmware.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#define CHUNK 4096u

typedef struct {
    int bus;
    int line; /* our end of the pseudo-terminal */
    int kept; /* the other end stays open, or the host's leaving would be an error here */
    struct timespec started;
    uint64_t counter_us; /* at the start */
} host;

static firmware self;

static void fail(const char *what) {
    perror(what);
    exit(1);
}

static uint64_t host_now_us(void *context) {
    const host *port = context;
    struct timespec now;
    if (clock_gettime(CLOCK_MONOTONIC, &now) != 0) {
        fail("clock");
    }
    return port->counter_us + (uint64_t)((int64_t)(now.tv_sec - port->started.tv_sec) * 1000000 +
                                         (now.tv_nsec - port->started.tv_nsec) / 1000);
}

static void write_all(int file, const uint8_t *bytes, size_t size) {
    while (size > 0) {
        ssize_t count = write(file, bytes, size);
        if (count < 0 && errno != EINTR) {
            fail("bus");
        }
        if (count > 0) {
            bytes += count;
            size -= (size_t)count;
        }
    }
}

static void read_all(int file, uint8_t *bytes, size_t size) {
    while (size > 0) {
        ssize_t count = read(file, bytes, size);
        if (count == 0) {
            exit(0); /* whoever served the bus has gone */
        }
        if (count < 0 && errno != EINTR) {
            fail("bus");
        }
        if (count > 0) {
            bytes += count;
            size -= (size_t)count;
        }
    }
}

static firmware_result ask(const host *port, uint8_t *question, const uint8_t *write, size_t write_size, uint8_t *read,
                           size_t read_size) {
    uint8_t whole[6 + LINK_MAX_PAYLOAD];
    uint8_t result;
    memcpy(whole, question, 6);
    if (write_size > 0) {
        memcpy(whole + 6, write, write_size);
    }
    write_all(port->bus, whole, 6 + write_size);
    read_all(port->bus, &result, 1);
    if (result == FIRMWARE_DONE) {
        read_all(port->bus, read, read_size);
    }
    return result <= FIRMWARE_REFUSED ? (firmware_result)result : FIRMWARE_REFUSED;
}

static firmware_result transact(const host *port, uint8_t kind, uint8_t address, const uint8_t *write,
                                size_t write_size, uint8_t *read, size_t read_size) {
    uint8_t question[6];
    question[0] = kind;
    question[1] = address;
    link_put16(question + 2, (uint16_t)write_size);
    link_put16(question + 4, (uint16_t)read_size);
    return ask(port, question, write, write_size, read, read_size);
}

static firmware_result host_i2c(void *context, uint8_t address, const uint8_t *write, size_t write_size, uint8_t *read,
                                size_t read_size) {
    return transact(context, 'I', address, write, write_size, read, read_size);
}

static firmware_result host_spi(void *context, uint8_t select, const uint8_t *write, size_t write_size, uint8_t *read,
                                size_t read_size) {
    return transact(context, 'S', select, write, write_size, read, read_size);
}

static firmware_result host_spi_set(void *context, uint8_t select, uint8_t mode, uint32_t clock_hz) {
    uint8_t question[6] = {'C', select, mode, 0, 0, 0};
    uint8_t clock[4];
    link_put32(clock, clock_hz);
    return ask(context, question, clock, sizeof clock, NULL, 0);
}

static size_t host_send(void *context, const uint8_t *bytes, size_t size) {
    const host *port = context;
    ssize_t count = write(port->line, bytes, size);
    if (count < 0 && errno != EAGAIN && errno != EINTR) {
        fail("line");
    }
    return count > 0 ? (size_t)count : 0;
}

static void open_line(host *port) {
    struct termios mode;
    const char *path;
    port->line = posix_openpt(O_RDWR | O_NOCTTY);
    if (port->line < 0 || port->line >= FD_SETSIZE || grantpt(port->line) != 0 || unlockpt(port->line) != 0) {
        fail("pseudo-terminal");
    }
    path = ptsname(port->line);
    if (path == NULL || (port->kept = open(path, O_RDWR | O_NOCTTY)) < 0 || tcgetattr(port->kept, &mode) != 0) {
        fail("pseudo-terminal");
    }
    mode.c_iflag = 0;
    mode.c_oflag = 0;
    mode.c_lflag = 0;
    mode.c_cflag = (mode.c_cflag & ~(tcflag_t)(CSIZE | PARENB)) | CS8;
    if (tcsetattr(port->kept, TCSANOW, &mode) != 0 || fcntl(port->line, F_SETFL, O_NONBLOCK) != 0) {
        fail("pseudo-terminal");
    }
    if (printf("%s\n", path) < 0 || fflush(stdout) != 0) {
        fail("standard output");
    }
}

static void serve(host *port) {
    static uint8_t bytes[CHUNK];
    for (;;) {
        uint32_t idle_us = firmware_step(&self);
        struct timespec idle;
        fd_set readable, writable;
        ssize_t count;
        int files = (port->line > port->bus ? port->line : port->bus) + 1;
        idle.tv_sec = idle_us / 1000000u;
        idle.tv_nsec = (long)(idle_us % 1000000u) * 1000;
        FD_ZERO(&readable);
        FD_ZERO(&writable);
        FD_SET(port->line, &readable);
        FD_SET(port->bus, &readable);
        if (firmware_waiting(&self)) {
            FD_SET(port->line, &writable);
        }
        if (pselect(files, &readable, &writable, NULL, &idle, NULL) < 0) {
            if (errno != EINTR) {
                fail("select");
            }
            continue;
        }
        if (FD_ISSET(port->bus, &readable)) {
            exit(0); /* nothing was asked: whoever served the bus has gone */
        }
        count = read(port->line, bytes, sizeof bytes);
        if (count > 0) {
            firmware_take(&self, bytes, (size_t)count);
        } else if (count < 0 && errno != EAGAIN && errno != EINTR) {
            fail("line");
        }
    }
}

/* Number of the argument behind `name`, or `otherwise`; a word that is no number ends the program. */
static unsigned long long option(int count, char **words, const char *name, unsigned long long otherwise) {
    for (int i = 1; i + 1 < count; i += 2) {
        if (strcmp(words[i], name) == 0) {
            char *end;
            unsigned long long value = strtoull(words[i + 1], &end, 10);
            if (*words[i + 1] == '\0' || *end != '\0') {
                fprintf(stderr, "%s %s: a number from 0 is required\n", name, words[i + 1]);
                exit(2);
            }
            return value;
        }
    }
    return otherwise;
}

int main(int count, char **words) {
    static host port;
    firmware_platform platform;
    memset(&platform, 0, sizeof platform);
    if (count % 2 == 0 || count == 1) {
        fprintf(stderr, "usage: %s --bus FILE_DESCRIPTOR [--counter-us N] [--selects N] [--watchdog-reset 1]\n",
                words[0]);
        return 2;
    }
    port.bus = (int)option(count, words, "--bus", 3);
    if (port.bus >= FD_SETSIZE) {
        fprintf(stderr, "--bus %d: at most %d\n", port.bus, (int)FD_SETSIZE - 1);
        return 2;
    }
    port.counter_us = option(count, words, "--counter-us", 0);
    if (clock_gettime(CLOCK_MONOTONIC, &port.started) != 0) {
        fail("clock");
    }
    platform.context = &port;
    platform.now_us = host_now_us;
    platform.i2c = host_i2c;
    platform.spi = host_spi;
    platform.spi_set = host_spi_set;
    platform.send = host_send;
    platform.selects = (uint8_t)option(count, words, "--selects", 8);
    platform.watchdog_reset = option(count, words, "--watchdog-reset", 0) != 0;
    firmware_init(&self, &platform);
    open_line(&port);
    serve(&port);
    return 0;
}
