/* A disk whose syncs fail: as often as the number in the file SYNC_FAILS says, of files whose path holds the word there.
   As a real one, it fails a sync once, and the next one finds nothing to complain of. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static int fails(int fd)
{
    const char *control = getenv("SYNC_FAILS");
    char link[64], of[64] = "", path[4096] = "";
    int left = 0, saved = errno;
    FILE *file;
    if (!control)
        return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    if (readlink(link, path, sizeof path - 1) < 0)
        return 0;
    file = fopen(control, "r+");
    if (file) {
        if (fscanf(file, "%d %63s", &left, of) == 2 && left > 0 && strstr(path, of)) {
            rewind(file);
            fprintf(file, "%-9d", left - 1);
        } else {
            left = 0;
        }
        fclose(file);
    }
    errno = left > 0 ? EIO : saved;
    return left > 0;
}

int fdatasync(int fd)
{
    int (*real)(int) = dlsym(RTLD_NEXT, "fdatasync");
    return fails(fd) ? -1 : real(fd);
}

int fsync(int fd)
{
    int (*real)(int) = dlsym(RTLD_NEXT, "fsync");
    return fails(fd) ? -1 : real(fd);
}
