/* Preloaded before the C library: makes the k-th of certain calls fail, in all processes of a run together.

   What fails is said by a file that all of them map, named in FAULTS; tests/faults.py writes it. Calls that concern a
   file count only if it lies below `root`; relative names do. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

enum { WRITE, TRUNCATE, CREATE, MKDIR, SYNC, RENAME, UNLINK, OPEN, READ, LOCK, MAP, FORK, THREAD, PAGES, MALLOC, KINDS };

struct control {
    uint64_t armed, kinds, first, times, error, spared; /* set before a run; a process in which nothing fails */
    uint64_t seen, fired, count[KINDS];         /* calls of the kinds, failures, and calls of each kind */
    char root[512], what[600];                  /* folder; the file of the first failure */
};

static volatile struct control *control;

__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("FAULTS");
    int file = path ? (int)syscall(SYS_openat, AT_FDCWD, path, O_RDWR | O_CLOEXEC) : -1;
    if (file < 0) return;
    void *found = (void *)syscall(SYS_mmap, NULL, sizeof *control, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    syscall(SYS_close, file);
    if (found != MAP_FAILED) control = found;
}

static int is_inside(const char *path) {
    return path[0] != '/' || !strncmp(path, (const char *)control->root, strlen((const char *)control->root));
}

/* Whether this call of a kind fails; it concerns the file `path`, or `file` if there is none, or no file if that is -1. */
static int fails(int kind, int file, const char *path) {
    char name[64], target[512];
    if (!control || !control->armed || (uint64_t)getpid() == control->spared) return 0;
    if (!path && file >= 0) {
        snprintf(name, sizeof name, "/proc/self/fd/%d", file);
        long n = syscall(SYS_readlink, name, target, sizeof target - 1);
        if (n <= 0 || target[0] != '/') return 0;
        target[n] = 0;
        path = target;
    }
    if (path && !is_inside(path)) return 0;
    __atomic_add_fetch(&control->count[kind], 1, __ATOMIC_SEQ_CST);
    if (!(control->kinds >> kind & 1)) return 0;
    uint64_t k = __atomic_add_fetch(&control->seen, 1, __ATOMIC_SEQ_CST);
    if (k < control->first || k - control->first >= control->times) return 0;
    if (!__atomic_fetch_add(&control->fired, 1, __ATOMIC_SEQ_CST))
        snprintf((char *)control->what, sizeof control->what, "%d %s", kind, path ? path : "");
    errno = (int)control->error;
    return 1;
}

#define REAL(name) ((__typeof__(&name))real(#name, &real_##name))
static void *real(const char *name, void **kept) { return *kept ? *kept : (*kept = dlsym(RTLD_NEXT, name)); }

/* Define a function that fails as the kind says, or else is the C library's. */
#define WRAP(kind, file, path, type, failed, name, parameters, arguments) \
    static void *real_##name; \
    type name parameters { return fails(kind, file, path) ? failed : REAL(name) arguments; }

WRAP(WRITE, f, NULL, ssize_t, -1, write, (int f, const void *b, size_t n), (f, b, n))
WRAP(WRITE, f, NULL, ssize_t, -1, pwrite, (int f, const void *b, size_t n, off_t o), (f, b, n, o))
WRAP(WRITE, f, NULL, ssize_t, -1, pwrite64, (int f, const void *b, size_t n, off64_t o), (f, b, n, o))
WRAP(WRITE, f, NULL, ssize_t, -1, writev, (int f, const struct iovec *v, int n), (f, v, n))
WRAP(WRITE, f, NULL, ssize_t, -1, pwritev, (int f, const struct iovec *v, int n, off_t o), (f, v, n, o))
WRAP(TRUNCATE, f, NULL, int, -1, ftruncate, (int f, off_t n), (f, n))
WRAP(TRUNCATE, f, NULL, int, -1, ftruncate64, (int f, off64_t n), (f, n))
WRAP(TRUNCATE, f, NULL, int, errno, posix_fallocate, (int f, off_t o, off_t n), (f, o, n))
WRAP(TRUNCATE, f, NULL, int, errno, posix_fallocate64, (int f, off64_t o, off64_t n), (f, o, n))
WRAP(MKDIR, -1, p, int, -1, mkdir, (const char *p, mode_t m), (p, m))
WRAP(SYNC, f, NULL, int, -1, fsync, (int f), (f))
WRAP(SYNC, f, NULL, int, -1, fdatasync, (int f), (f))
WRAP(RENAME, -1, b, int, -1, rename, (const char *a, const char *b), (a, b))
WRAP(RENAME, -1, b, int, -1, renameat, (int f, const char *a, int g, const char *b), (f, a, g, b))
WRAP(UNLINK, -1, p, int, -1, unlink, (const char *p), (p))
WRAP(UNLINK, -1, p, int, -1, unlinkat, (int f, const char *p, int o), (f, p, o))
WRAP(READ, f, NULL, ssize_t, -1, read, (int f, void *b, size_t n), (f, b, n))
WRAP(READ, f, NULL, ssize_t, -1, pread, (int f, void *b, size_t n, off_t o), (f, b, n, o))
WRAP(READ, f, NULL, ssize_t, -1, pread64, (int f, void *b, size_t n, off64_t o), (f, b, n, o))
WRAP(LOCK, f, NULL, int, -1, flock, (int f, int o), (f, o))
WRAP(THREAD, -1, NULL, int, errno, pthread_create,
     (pthread_t *t, const pthread_attr_t *a, void *(*g)(void *), void *x), (t, a, g, x))
WRAP(f < 0 ? PAGES : MAP, f, NULL, void *, MAP_FAILED, mmap,
     (void *a, size_t n, int p, int s, int f, off_t o), (a, n, p, s, f, o))
WRAP(f < 0 ? PAGES : MAP, f, NULL, void *, MAP_FAILED, mmap64,
     (void *a, size_t n, int p, int s, int f, off64_t o), (a, n, p, s, f, o))

static void *real_fork;
pid_t fork(void) { return fails(FORK, -1, NULL) ? -1 : REAL(fork)(); }
pid_t vfork(void) { return fork(); } /* whose frame must not be left before the child has begun its program */

/* A file that is there is opened on a full disk too. */
static int opening(int flags, const char *path) {
    return flags & O_CREAT && faccessat(AT_FDCWD, path, F_OK, 0) ? CREATE : OPEN;
}
#define MODE \
    va_list rest; \
    va_start(rest, flags); \
    mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, mode_t) : 0; \
    va_end(rest);
#define WRAP_OPEN(name, parameters, arguments) \
    static void *real_##name; \
    int name parameters { MODE return fails(opening(flags, p), -1, p) ? -1 : REAL(name) arguments; }
WRAP_OPEN(open, (const char *p, int flags, ...), (p, flags, mode))
WRAP_OPEN(open64, (const char *p, int flags, ...), (p, flags, mode))
WRAP_OPEN(openat, (int f, const char *p, int flags, ...), (f, p, flags, mode))
WRAP_OPEN(openat64, (int f, const char *p, int flags, ...), (f, p, flags, mode))
WRAP(opening(m[0] == 'r' ? 0 : O_CREAT, p), -1, p, FILE *, NULL, fopen, (const char *p, const char *m), (p, m))
WRAP(opening(m[0] == 'r' ? 0 : O_CREAT, p), -1, p, FILE *, NULL, fopen64, (const char *p, const char *m), (p, m))

extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t);
void *malloc(size_t n) { return fails(MALLOC, -1, NULL) ? NULL : __libc_malloc(n); }
void *calloc(size_t n, size_t m) { return fails(MALLOC, -1, NULL) ? NULL : __libc_calloc(n, m); }
void *realloc(void *p, size_t n) { return fails(MALLOC, -1, NULL) ? NULL : __libc_realloc(p, n); }

/* A disk that stays full says so when asked. */
static int is_full(void) { return control && control->fired && control->times > 1 && control->error == ENOSPC; }
#define WRAP_STATVFS(name, type, parameter, argument) \
    static void *real_##name; \
    int name(parameter, struct type *s) { \
        int result = REAL(name)(argument, s); \
        if (!result && is_full()) s->f_bavail = s->f_bfree = 0; \
        return result; \
    }
WRAP_STATVFS(statvfs, statvfs, const char *p, p)
WRAP_STATVFS(statvfs64, statvfs64, const char *p, p)
WRAP_STATVFS(fstatvfs, statvfs, int f, f)
WRAP_STATVFS(fstatvfs64, statvfs64, int f, f)
