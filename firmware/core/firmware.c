#include "firmware.h"

#include <string.h>

enum { HELLO = 0x01, TRANSFER = 0x02, LIST = 0x03, START = 0x04, STOP = 0x05 };
enum { RESEND = 0x06, STATUS = 0x07, SELECT = 0x08 };
enum { ANSWER = 0x80, DATA = 0xD0 };
enum { CAN_RESEND = 1, CAN_STATUS = 2, CAN_COUNT = 4 };
enum { COUNTED = 0x80, BIG_ENDIAN_COUNT = 1, COUNT_OF_PACKETS = 2 };
enum { FIRST_SELECT = 0x80 };

#define AGE_NOBODY 0xFFFFu
#define AGE_HELD 0xFFFEu
#define LONGEST_AGE_US 0xFFFDu
#define RECORD 4u /* bytes before a kept frame */

/* A size that a port has set badly is an array of negative length. */
typedef char lists_have_a_byte[FIRMWARE_LISTS <= 255u ? 1 : -1];
typedef char requests_have_two_bytes[FIRMWARE_REQUEST_BYTES <= 65535u ? 1 : -1];
typedef char the_line_holds_data_and_an_answer[FIRMWARE_LINE_BYTES >= 2u * LINK_MAX_FRAME ? 1 : -1];
typedef char the_memory_holds_a_frame[FIRMWARE_KEPT_BYTES >= 2u * (LINK_MAX_FRAME + RECORD) ? 1 : -1];

static uint64_t now_us(const firmware *self) {
    return self->platform.now_us(self->platform.context);
}

static void feed_watchdog(const firmware *self) {
    if (self->platform.feed_watchdog != NULL) {
        self->platform.feed_watchdog(self->platform.context);
    }
}

/* ---- the line -------------------------------------------------------------------------------------------------- */

static size_t smaller(size_t a, size_t b) {
    return a < b ? a : b;
}

static void copy_in(uint8_t *ring, size_t capacity, size_t at, const uint8_t *bytes, size_t size) {
    size_t first = smaller(size, capacity - at % capacity);
    memcpy(ring + at % capacity, bytes, first);
    memcpy(ring, bytes + first, size - first);
}

static void copy_out(const uint8_t *ring, size_t capacity, size_t at, uint8_t *bytes, size_t size) {
    size_t first = smaller(size, capacity - at % capacity);
    memcpy(bytes, ring + at % capacity, first);
    memcpy(bytes + first, ring, size - first);
}

static void flush(firmware *self) {
    firmware_line *line = &self->line;
    while (line->size > 0) {
        size_t piece = smaller(line->size, FIRMWARE_LINE_BYTES - line->start);
        size_t taken = self->platform.send(self->platform.context, line->bytes + line->start, piece);
        line->start = (line->start + taken) % FIRMWARE_LINE_BYTES;
        line->size -= taken;
        if (taken < piece) {
            return;
        }
    }
}

/* A frame goes on the line whole or not at all; `spare` bytes stay free behind it. */
static bool put(firmware *self, const uint8_t *frame, size_t size, size_t spare) {
    firmware_line *line = &self->line;
    if (line->size + size + spare > FIRMWARE_LINE_BYTES) {
        flush(self);
    }
    if (line->size + size + spare > FIRMWARE_LINE_BYTES) {
        return false;
    }
    copy_in(line->bytes, FIRMWARE_LINE_BYTES, line->start + line->size, frame, size);
    line->size += size;
    return true;
}

bool firmware_waiting(const firmware *self) {
    return self->line.size > 0;
}

/* ---- DATA that is kept until it is acknowledged ------------------------------------------------------------------ */

/* Number and size of the record that stands `at` bytes behind the oldest one. */
static uint32_t record_at(const firmware_memory *memory, size_t at, size_t *size) {
    uint8_t head[RECORD + 4];
    copy_out(memory->bytes, FIRMWARE_KEPT_BYTES, memory->start + at, head, sizeof head);
    *size = RECORD + LINK_OVERHEAD + link_get16(head + RECORD + 2);
    return link_get32(head);
}

static void forget_oldest(firmware_memory *memory) {
    size_t size;
    (void)record_at(memory, 0, &size);
    memory->start = (memory->start + size) % FIRMWARE_KEPT_BYTES;
    memory->size -= size;
}

static void keep(firmware *self, uint32_t number, const uint8_t *frame, size_t size) {
    firmware_memory *memory = &self->memory;
    uint8_t head[RECORD];
    while (memory->size + RECORD + size > FIRMWARE_KEPT_BYTES) {
        forget_oldest(memory);
        self->counts.overwritten++;
    }
    link_put32(head, number);
    copy_in(memory->bytes, FIRMWARE_KEPT_BYTES, memory->start + memory->size, head, RECORD);
    copy_in(memory->bytes, FIRMWARE_KEPT_BYTES, memory->start + memory->size + RECORD, frame, size);
    memory->size += RECORD + size;
}

/*
 * Forget what is before number `first`, and send numbers `first` ... `first + count - 1` again as far as there is room.
 * Returns how many frames were sent; `next` is the number to go on with.
 */
static uint16_t send_again(firmware *self, uint32_t first, uint32_t count, uint32_t *next) {
    firmware_memory *memory = &self->memory;
    uint16_t sent = 0;
    size_t at = 0;
    size_t size;
    while (memory->size > 0 && (int32_t)(record_at(memory, 0, &size) - first) < 0) {
        forget_oldest(memory);
    }
    *next = first + count;
    while (at < memory->size) {
        uint32_t number = record_at(memory, at, &size);
        if (number - first >= count) {
            break;
        }
        copy_out(memory->bytes, FIRMWARE_KEPT_BYTES, memory->start + at + RECORD, self->data, size - RECORD);
        if (!put(self, self->data, size - RECORD, LINK_MAX_FRAME)) {
            *next = number;
            break;
        }
        sent++;
        at += size;
    }
    return sent;
}

/* ---- transactions ------------------------------------------------------------------------------------------------ */

/* Addresses from 80 on are chip selects of SPI. */
static firmware_result transaction(firmware *self, uint8_t address, const uint8_t *write, size_t write_size,
                                   uint8_t *read, size_t read_size) {
    const firmware_platform *platform = &self->platform;
    feed_watchdog(self);
    if (address < FIRST_SELECT) {
        if (platform->i2c == NULL) {
            return FIRMWARE_REFUSED;
        }
        return platform->i2c(platform->context, address, write, write_size, read, read_size);
    }
    if (platform->spi == NULL || address - FIRST_SELECT >= platform->selects) {
        return FIRMWARE_REFUSED;
    }
    return platform->spi(platform->context, (uint8_t)(address - FIRST_SELECT), write, write_size, read, read_size);
}

/* ---- lists ------------------------------------------------------------------------------------------------------- */

/* A request: address, bytes to write, bytes to read, what to write; of a counted one the rule stands before that. */
#define REQUEST_HEAD 3u
#define RULE 5u

typedef struct {
    uint8_t address;
    uint8_t write_size;
    uint8_t read_size;  /* bytes of its answer; a counted one may read fewer */
    const uint8_t *rule; /* NULL unless it is counted */
    const uint8_t *write;
    size_t size; /* of all of it */
} request_parts;

/* The request at the beginning of `bytes`; false if they are too few for one. */
static bool take_apart(const uint8_t *bytes, size_t size, request_parts *request) {
    bool counted;
    size_t head;
    if (size < REQUEST_HEAD) {
        return false;
    }
    counted = (bytes[1] & COUNTED) != 0;
    head = counted ? REQUEST_HEAD + RULE : REQUEST_HEAD;
    request->address = bytes[0];
    request->write_size = (uint8_t)(bytes[1] & ~COUNTED);
    request->read_size = bytes[2];
    request->rule = counted ? bytes + REQUEST_HEAD : NULL;
    request->write = bytes + head;
    request->size = head + request->write_size;
    return size >= request->size;
}

/* How many bytes a counted request reads: whole packets, as many as the answer before it counts and there is room for. */
static size_t counted_bytes(const request_parts *request, const uint8_t *answer) {
    const uint8_t *rule = request->rule;
    const uint8_t *at = answer + rule[0];
    size_t count = (rule[1] & BIG_ENDIAN_COUNT) != 0 ? (size_t)(at[0] << 8 | at[1]) : (size_t)(at[1] << 8 | at[0]);
    size_t packet = rule[4];
    count &= link_get16(rule + 2);
    if ((rule[1] & COUNT_OF_PACKETS) == 0) {
        count /= packet;
    }
    return smaller(count, request->read_size / packet) * packet;
}

static void forget_list(firmware *self, firmware_list *list) {
    if (!list->used) {
        return;
    }
    memmove(self->requests + list->start, self->requests + list->start + list->size,
            self->request_bytes - list->start - list->size);
    self->request_bytes -= list->size;
    for (size_t i = 0; i < FIRMWARE_LISTS; i++) {
        if (self->lists[i].used && self->lists[i].start > list->start) {
            self->lists[i].start = (uint16_t)(self->lists[i].start - list->size);
        }
    }
    list->used = false;
    list->size = 0;
}

static void forget_lists(firmware *self) {
    for (size_t i = 0; i < FIRMWARE_LISTS; i++) {
        self->lists[i].used = false;
        self->lists[i].size = 0;
    }
    self->request_bytes = 0;
    self->period_us = 0;
}

/*
 * The requests of a LIST must fill it exactly, name buses that there are, and their answers must fit into a frame. A
 * counted one has packets of some bytes, and before it an answer in which its count stands.
 */
static bool well_formed(const firmware *self, const uint8_t *body, size_t size) {
    size_t at = 0;
    size_t answer = 1;
    size_t before = 0;
    while (at < size) {
        request_parts request;
        if (!take_apart(body + at, size - at, &request)) {
            return false;
        }
        if (request.address >= FIRST_SELECT && request.address - FIRST_SELECT >= self->platform.selects) {
            return false;
        }
        if (request.rule != NULL && (request.rule[0] + 2u > before || request.rule[4] == 0)) {
            return false;
        }
        before = request.read_size;
        answer += 2u + request.read_size;
        at += request.size;
    }
    return answer <= LINK_MAX_PAYLOAD;
}

static firmware_result take_list(firmware *self, const uint8_t *payload, size_t size) {
    firmware_list *list;
    uint16_t every, offset;
    size_t body;
    if (size < 5 || payload[0] >= FIRMWARE_LISTS) {
        return FIRMWARE_REFUSED;
    }
    list = &self->lists[payload[0]];
    every = link_get16(payload + 1);
    offset = link_get16(payload + 3);
    body = size - 5;
    if (offset >= every || !well_formed(self, payload + 5, body)) {
        return FIRMWARE_REFUSED;
    }
    if (self->request_bytes - list->size + body > FIRMWARE_REQUEST_BYTES) {
        return FIRMWARE_REFUSED;
    }
    forget_list(self, list);
    memcpy(self->requests + self->request_bytes, payload + 5, body);
    list->used = true;
    list->every = every;
    list->offset = offset;
    list->start = (uint16_t)self->request_bytes;
    list->size = (uint16_t)body;
    self->request_bytes += body;
    return FIRMWARE_DONE;
}

/*
 * One request that reads `size` bytes, tried a second time if nobody acknowledges; when the try began whose result it
 * is. What is not read of the answer is 0.
 */
static firmware_result try_twice(firmware *self, const request_parts *request, size_t size, uint8_t *read,
                                 uint32_t *begun) {
    firmware_result result = FIRMWARE_NOBODY;
    memset(read, 0, request->read_size);
    for (int attempt = 0; attempt < 2 && result == FIRMWARE_NOBODY; attempt++) {
        *begun = (uint32_t)now_us(self);
        result = transaction(self, request->address, request->write, request->write_size, read, size);
    }
    if (result != FIRMWARE_DONE) {
        memset(read, 0, request->read_size);
        self->counts.failures++;
    }
    return result;
}

/* The same for a request behind one with this result and answer; a count that failed or is 0 leaves nothing to read. */
static firmware_result try_request(firmware *self, const request_parts *request, firmware_result before,
                                   const uint8_t *answer, uint8_t *read, uint32_t *begun) {
    size_t size = request->read_size;
    if (request->rule != NULL) {
        size = before == FIRMWARE_DONE ? counted_bytes(request, answer) : 0;
        if (size == 0) {
            *begun = (uint32_t)now_us(self);
            memset(read, 0, request->read_size);
            return before;
        }
    }
    return try_twice(self, request, size, read, begun);
}

/* Read what one list asks for, and send it. */
static void go_through(firmware *self, uint8_t name, const firmware_list *list, uint64_t number) {
    const uint8_t *bytes = self->requests + list->start;
    const uint8_t *end = bytes + list->size;
    uint8_t *payload = self->data + LINK_HEADER;
    const uint8_t *answer = payload;
    firmware_result result = FIRMWARE_DONE;
    request_parts request;
    size_t at = 1;
    size_t size;
    uint32_t sent;
    payload[0] = name;
    for (uint16_t i = 0; take_apart(bytes, (size_t)(end - bytes), &request); i++) {
        result = try_request(self, &request, result, answer, payload + at + 2, &self->begun[i]);
        answer = payload + at + 2;
        /* 0 for now: an age follows when all is read. */
        link_put16(payload + at, result == FIRMWARE_DONE ? 0 : result == FIRMWARE_HELD ? AGE_HELD : AGE_NOBODY);
        at += 2u + request.read_size;
        bytes += request.size;
    }
    size = at;
    sent = (uint32_t)now_us(self);
    bytes = self->requests + list->start;
    at = 1;
    for (uint16_t i = 0; take_apart(bytes, (size_t)(end - bytes), &request); i++) {
        if (link_get16(payload + at) == 0) {
            uint32_t age = sent - self->begun[i];
            link_put16(payload + at, (uint16_t)(age < LONGEST_AGE_US ? age : LONGEST_AGE_US));
        }
        at += 2u + request.read_size;
        bytes += request.size;
    }
    size = link_complete(self->data, DATA, (uint16_t)(number & 0xFFFFu), sent, size);
    keep(self, (uint32_t)number, self->data, size);
    if (put(self, self->data, size, LINK_MAX_FRAME)) {
        self->counts.sent++;
    } else {
        self->counts.dropped++;
    }
}

/* The next frame, if it is time to; one that would begin a whole frame late is left out. */
static void tick(firmware *self) {
    uint64_t due_us = self->begun_us + self->number * self->period_us;
    uint64_t now = now_us(self);
    uint64_t number;
    if (self->period_us == 0 || due_us > now) {
        return;
    }
    number = self->number + (now - due_us) / self->period_us;
    self->counts.late += (uint32_t)(number - self->number);
    self->number = number + 1;
    for (size_t i = 0; i < FIRMWARE_LISTS; i++) {
        const firmware_list *list = &self->lists[i];
        if (list->used && number % list->every == list->offset) {
            go_through(self, (uint8_t)i, list, number);
        }
    }
}

/* ---- commands ---------------------------------------------------------------------------------------------------- */

static size_t result_of(uint8_t *answer, firmware_result result) {
    answer[0] = (uint8_t)result;
    return 1;
}

static size_t hello(firmware *self, uint8_t *answer) {
    forget_lists(self);
    self->memory.size = 0;
    answer[0] = FIRMWARE_VERSION;
    answer[1] = FIRMWARE_LISTS;
    link_put16(answer + 2, FIRMWARE_REQUEST_BYTES);
    answer[4] = CAN_RESEND | CAN_STATUS | CAN_COUNT;
    answer[5] = self->platform.spi != NULL && self->platform.spi_set != NULL ? self->platform.selects : 0;
    link_put32(answer + 6, FIRMWARE_KEPT_BYTES);
    return 10;
}

static size_t transfer(firmware *self, const uint8_t *payload, size_t size, uint8_t *answer) {
    size_t read;
    firmware_result result;
    if (size < 3) {
        return result_of(answer, FIRMWARE_REFUSED);
    }
    read = link_get16(payload + 1);
    if (read + 1 > LINK_MAX_PAYLOAD) {
        return result_of(answer, FIRMWARE_REFUSED);
    }
    result = transaction(self, payload[0], payload + 3, size - 3, answer + 1, read);
    return result_of(answer, result) + (result == FIRMWARE_DONE ? read : 0);
}

static size_t start(firmware *self, const uint8_t *payload, size_t size, uint8_t *answer) {
    if (size != 4 || link_get32(payload) == 0) {
        return result_of(answer, FIRMWARE_REFUSED);
    }
    self->period_us = link_get32(payload);
    self->begun_us = now_us(self);
    self->number = 0;
    self->memory.size = 0;
    return result_of(answer, FIRMWARE_DONE);
}

static size_t resend(firmware *self, const uint8_t *payload, size_t size, uint8_t *answer) {
    uint32_t first, next;
    uint16_t sent;
    if (size != 4) {
        return result_of(answer, FIRMWARE_REFUSED);
    }
    /* The number at or before the next frame that is written so. */
    first = (uint32_t)self->number - (uint16_t)((uint16_t)self->number - link_get16(payload));
    sent = send_again(self, first, link_get16(payload + 2), &next);
    link_put16(answer + 1, sent);
    link_put16(answer + 3, (uint16_t)(next & 0xFFFFu));
    return result_of(answer, FIRMWARE_DONE) + 4;
}

static size_t status(firmware *self, uint8_t *answer) {
    const firmware_counts *counts = &self->counts;
    answer[1] = self->platform.watchdog_reset ? 1 : 0;
    link_put64(answer + 2, now_us(self));
    link_put32(answer + 10, counts->sent);
    link_put32(answer + 14, counts->late);
    link_put32(answer + 18, counts->dropped);
    link_put32(answer + 22, counts->overwritten);
    link_put32(answer + 26, counts->failures);
    link_put32(answer + 30, self->receiver.skipped);
    return result_of(answer, FIRMWARE_DONE) + 33;
}

static size_t select_chip(firmware *self, const uint8_t *payload, size_t size, uint8_t *answer) {
    const firmware_platform *platform = &self->platform;
    if (size != 6 || platform->spi_set == NULL || payload[0] >= platform->selects || payload[1] > 3) {
        return result_of(answer, FIRMWARE_REFUSED);
    }
    return result_of(answer, platform->spi_set(platform->context, payload[0], payload[1], link_get32(payload + 2)));
}

static size_t carry_out(firmware *self, const link_frame *command, uint8_t *answer) {
    const uint8_t *payload = command->payload;
    size_t size = command->size;
    switch (command->kind) {
    case HELLO:
        return hello(self, answer);
    case TRANSFER:
        return transfer(self, payload, size, answer);
    case LIST:
        return result_of(answer, take_list(self, payload, size));
    case START:
        return start(self, payload, size, answer);
    case STOP:
        forget_lists(self);
        return result_of(answer, FIRMWARE_DONE);
    case RESEND:
        return resend(self, payload, size, answer);
    case STATUS:
        return status(self, answer);
    case SELECT:
        return select_chip(self, payload, size, answer);
    default:
        return result_of(answer, FIRMWARE_REFUSED);
    }
}

/*
 * Answer a command; the very same frame again is answered again and not done again, unless it is HELLO. What is itself
 * an answer, or would be answered by what looks like DATA, is none: a line that echoes would never be silent again.
 */
static void obey(firmware *self, const link_frame *command) {
    bool again;
    if ((command->kind & ANSWER) != 0 || (command->kind | ANSWER) == DATA) {
        return;
    }
    again = command->raw_size == self->command_size && memcmp(command->raw, self->command, command->raw_size) == 0;
    if (!again || command->kind == HELLO) {
        size_t size = carry_out(self, command, self->answer + LINK_HEADER);
        memcpy(self->command, command->raw, command->raw_size);
        self->command_size = command->raw_size;
        self->answer_size =
            link_complete(self->answer, command->kind | ANSWER, command->sequence, (uint32_t)now_us(self), size);
    }
    /* Without room it is not answered: nobody reads. The host asks again. */
    (void)put(self, self->answer, self->answer_size, 0);
}

/* ---- interface --------------------------------------------------------------------------------------------------- */

void firmware_init(firmware *self, const firmware_platform *platform) {
    memset(self, 0, sizeof *self);
    self->platform = *platform;
    link_receiver_init(&self->receiver);
}

/* A frame in which nothing arrives any more would hide the commands that follow it. */
static void end_pause(firmware *self) {
    link_frame command;
    if (self->receiver.size == self->receiver.taken || now_us(self) - self->heard_us < FIRMWARE_PAUSE_US) {
        return;
    }
    while (link_receive_pause(&self->receiver, &command)) {
        obey(self, &command);
    }
}

void firmware_take(firmware *self, const uint8_t *bytes, size_t size) {
    link_frame command;
    bool found = true;
    if (size == 0) {
        return;
    }
    end_pause(self);
    self->heard_us = now_us(self);
    while (found || size > 0) {
        size_t taken = link_receive(&self->receiver, bytes, size, &command, &found);
        bytes += taken;
        size -= taken;
        if (found) {
            feed_watchdog(self);
            obey(self, &command);
        }
    }
    flush(self);
}

uint32_t firmware_step(firmware *self) {
    uint64_t due_us, now;
    feed_watchdog(self);
    end_pause(self);
    tick(self);
    flush(self);
    if (self->period_us == 0) {
        return FIRMWARE_IDLE_US;
    }
    due_us = self->begun_us + self->number * self->period_us;
    now = now_us(self);
    if (due_us <= now) {
        return 0;
    }
    return (uint32_t)(due_us - now < FIRMWARE_IDLE_US ? due_us - now : FIRMWARE_IDLE_US);
}
