/* Notes every call that changes a disk, in order and with its data: LD_PRELOAD this, RECORD_WRITES=FILE, RECORD_UNDER=FOLDER.
   A note: kind u8, inode u64, offset i64, length u64, then that many bytes (data, or a name, or two names with a 0 between).
   Kinds: c create, t truncate or extend to offset, w write, s sync, r rename, u unlink. Only files under FOLDER count. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

static pthread_mutex_t order = PTHREAD_MUTEX_INITIALIZER;
static int notes = -1;
static const char *under;
static ssize_t (*real_write)(int, const void *, size_t);

__attribute__((constructor)) static void begin(void) {
  const char *name = getenv("RECORD_WRITES");
  under = getenv("RECORD_UNDER");
  real_write = dlsym(RTLD_NEXT, "write");
  if (name && under) notes = open(name, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
}

static void note(char kind, uint64_t inode, int64_t offset, const void *data, uint64_t length) {
  char head[25];
  head[0] = kind;
  memcpy(head + 1, &inode, 8);
  memcpy(head + 9, &offset, 8);
  memcpy(head + 17, &length, 8);
  if (real_write(notes, head, 25) != 25 || real_write(notes, data, length) != (ssize_t)length) abort();
}

/* The inode of a file that counts, 0 of others. */
static uint64_t counts(int fd) {
  char link[64], path[4096];
  struct stat about;
  if (notes < 0 || fd == notes) return 0;
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  ssize_t length = readlink(link, path, sizeof path - 1);
  if (length < 0 || fstat(fd, &about)) return 0;
  path[length] = 0;
  return strncmp(path, under, strlen(under)) ? 0 : about.st_ino;
}

#define REAL(name) __typeof__(&name) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)
#define ORDERED(expression) pthread_mutex_lock(&order); __typeof__(expression) done = (expression)
#define RETURN pthread_mutex_unlock(&order); return done

#define OPEN(name)                                                                    \
  int name(const char *path, int flags, ...) {                                        \
    REAL(name);                                                                       \
    va_list more;                                                                     \
    va_start(more, flags);                                                            \
    mode_t mode = flags & O_CREAT ? va_arg(more, mode_t) : 0;                         \
    va_end(more);                                                                     \
    ORDERED(real(path, flags, mode));                                                 \
    uint64_t inode = done >= 0 && flags & O_CREAT ? counts(done) : 0;                 \
    if (inode) note('c', inode, flags & O_TRUNC ? 1 : 0, path, strlen(path));         \
    RETURN;                                                                           \
  }
OPEN(open)
OPEN(open64)

#define OPENAT(name)                                                                  \
  int name(int folder, const char *path, int flags, ...) {                            \
    REAL(name);                                                                       \
    va_list more;                                                                     \
    va_start(more, flags);                                                            \
    mode_t mode = flags & O_CREAT ? va_arg(more, mode_t) : 0;                         \
    va_end(more);                                                                     \
    ORDERED(real(folder, path, flags, mode));                                         \
    uint64_t inode = done >= 0 && flags & O_CREAT ? counts(done) : 0;                 \
    if (inode) note('c', inode, flags & O_TRUNC ? 1 : 0, path, strlen(path));         \
    RETURN;                                                                           \
  }
OPENAT(openat)
OPENAT(openat64)

ssize_t write(int fd, const void *data, size_t length) {
  uint64_t inode = counts(fd);
  if (!inode) return real_write(fd, data, length);
  ORDERED(real_write(fd, data, length));
  if (done > 0) note('w', inode, lseek(fd, 0, SEEK_CUR) - done, data, done);
  RETURN;
}

#define PWRITE(name, offset_type)                                                     \
  ssize_t name(int fd, const void *data, size_t length, offset_type offset) {         \
    REAL(name);                                                                       \
    uint64_t inode = counts(fd);                                                      \
    ORDERED(real(fd, data, length, offset));                                          \
    if (inode && done > 0) note('w', inode, offset, data, done);                      \
    RETURN;                                                                           \
  }
PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)

#define TRUNCATE(name, offset_type)                                                   \
  int name(int fd, offset_type length) {                                              \
    REAL(name);                                                                       \
    uint64_t inode = counts(fd);                                                      \
    ORDERED(real(fd, length));                                                        \
    if (inode && !done) note('t', inode, length, "", 0);                              \
    RETURN;                                                                           \
  }
TRUNCATE(ftruncate, off_t)
TRUNCATE(ftruncate64, off64_t)

#define ALLOCATE(name, offset_type)                                                   \
  int name(int fd, offset_type offset, offset_type length) {                          \
    REAL(name);                                                                       \
    struct stat about;                                                                \
    uint64_t inode = counts(fd);                                                      \
    ORDERED(real(fd, offset, length));                                                \
    if (inode && !done && !fstat(fd, &about)) note('t', inode, about.st_size, "", 0); \
    RETURN;                                                                           \
  }
ALLOCATE(posix_fallocate, off_t)
ALLOCATE(posix_fallocate64, off64_t)

#define SYNC(name)                                                                    \
  int name(int fd) {                                                                  \
    REAL(name);                                                                       \
    uint64_t inode = counts(fd);                                                      \
    ORDERED(real(fd));                                                                \
    if (inode && !done) note('s', inode, 0, "", 0);                                   \
    RETURN;                                                                           \
  }
SYNC(fsync)
SYNC(fdatasync)

static void note_names(char kind, const char *one, const char *two) {
  char names[8192];
  if (notes < 0 || strncmp(one, under, strlen(under))) return;
  int length = snprintf(names, sizeof names, "%s%c%s", one, 0, two);
  note(kind, 0, 0, names, length);
}

int rename(const char *from, const char *to) {
  REAL(rename);
  ORDERED(real(from, to));
  if (!done) note_names('r', from, to);
  RETURN;
}

int unlink(const char *path) {
  REAL(unlink);
  ORDERED(real(path));
  if (!done) note_names('u', path, "");
  RETURN;
}
